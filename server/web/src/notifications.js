/** Notifications of the browser when one's jobs end, for who has asked for them by a click. */

import { announce } from "./announce.js";
import { get, pause } from "./api.js";
import { h } from "./dom.js";
import { jobName, lives, state as stateWord } from "./format.js";
import { go } from "./navigation.js";

const PLACE = "morph-notify";
const PAUSE = 10_000; // [ms] between looks, also while nobody looks at the page
const LISTED = 100; // the newest jobs, among which those are found that may end

const WORKERS_ALONE = /Android.*Chrome/; // browsers that have notifications of service workers alone

let watching = null;

/** Whether this browser has notifications, which it has for safe addresses alone. */
export function available() {
  return "Notification" in window && isSecureContext && !WORKERS_ALONE.test(navigator.userAgent);
}

/** Whether they are wanted and allowed. */
export function notifies() {
  return available() && localStorage.getItem(PLACE) === "on" && Notification.permission === "granted";
}

/** Begin to tell, if that was wanted before. */
export function startNotifying() {
  if (!notifies() || watching) return;
  watching = new AbortController();
  watch(watching.signal);
}

/** Tell from now on, or tell no more; the browser asks the person where it has not before. */
export async function switchNotifying() {
  const on = !notifies();
  if (on && (await Notification.requestPermission()) !== "granted") return explain();
  localStorage.setItem(PLACE, on ? "on" : "off");
  watching?.abort();
  watching = null;
  startNotifying();
  announce(on ? "You will be notified when a job of yours ends." : "Notifications are off.");
}

async function watch(signal) {
  const unfinished = new Set();
  let mark = null;
  while (!signal.aborted) {
    try {
      mark = await look(mark, unfinished, signal);
    } catch (error) {
      if (signal.aborted) return;
      if (error.name !== "Problem") throw error; // without an answer, it asks again later
    }
    await pause(PAUSE, signal);
  }
}

/**
 * See which jobs have ended since the last look.
 *
 * @param {Date | null} mark null at the first look.
 * @returns {Promise<Date>} the mark from then on: when the newest job of the first look was made, by the service's
 *   clock. Whatever job is newer is news.
 */
async function look(mark, unfinished, signal) {
  const { owner } = await get("/queue", { signal, quiet: true });
  const { items } = await get("/jobs", { query: { owner, limit: LISTED }, signal, quiet: true });
  mark ??= new Date(items[0]?.created_at ?? 0);
  const listed = new Map(items.map((job) => [job.id, job]));
  for (const job of items) {
    const seen = unfinished.has(job.id);
    if (lives(job.state)) unfinished.add(job.id);
    else if (seen || new Date(job.created_at) > mark) ended(job, unfinished);
  }
  for (const id of [...unfinished].filter((one) => !listed.has(one))) {
    const job = await get(`/jobs/${id}`, { signal, quiet: true }).catch((error) => {
      if (error.status !== 404) throw error;
      unfinished.delete(id); // it was deleted
      return null;
    });
    if (job && !lives(job.state)) ended(job, unfinished);
  }
  return mark;
}

const told = new Set();

function ended(job, unfinished) {
  unfinished.delete(job.id);
  const end = `${job.id} ${job.finished_at}`;
  if (told.has(end) || job.state === "cancelled") return; // who cancels knows
  told.add(end);
  const body = [stateWord(job.state), job.problem?.cause].filter(Boolean).join(": ");
  let note;
  try {
    note = new Notification(jobName(job), { body, tag: end }); // one for all tabs
  } catch (error) {
    return console.warn("no notification", error); // where only service workers may show any
  }
  note.addEventListener("click", () => {
    window.focus();
    note.close();
    go(`/jobs/${job.id}`);
  });
}

/** The browser has been told to show none. */
function explain() {
  const dialog = h(
    "dialog",
    { "aria-labelledby": "blocked" },
    h(
      "form",
      { method: "dialog", class: "stack" },
      h("h2", { id: "blocked" }, "Notifications are blocked"),
      h("p", null, "The browser blocks them for this page. Allow them in its settings for this page, and try again."),
      h("div", { class: "actions" }, h("button", { class: "primary" }, "Close")),
    ),
  );
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}
