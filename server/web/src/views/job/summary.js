/** A job in words: what it is, how far it has come, how good it is, what may be done with it. */
import { announce } from "../../announce.js";
import { get } from "../../api.js";
import { fill, h, redraw } from "../../dom.js";
import { count, duration, jobName, jobShapes, lives, number, percent, plural, state as word, when } from "../../format.js";
import { go } from "../../navigation.js";
import { shared } from "../../share_link.js";
import { inTitles, problemNotice } from "../../problem_notice.js";
import { MAX_COMPARED } from "../compare/max_compared.js";
import { actions } from "../jobs/actions.js";
import { STAGES } from "./sentences.js";

const GONE = "The service does not answer. The page reconnects by itself when it is back.";
const METRICS = [
  ["two_sided", "Chamfer distance", "dx"],
  ["hausdorff", "Hausdorff", "dx"],
  ["f1", "F1", ""],
  ["coverage", "Coverage", ""],
  ["iou", "Volume overlap", ""],
];

/** `headline` and `element`, the rest; what has not changed is left alone, so that the focus stays. */
export class Summary {
  /** @param {{changed: () => Promise<void>, signal: AbortSignal}} options */
  constructor({ changed, signal }) {
    Object.assign(this, { changed, signal });
    this.drawn = {};
    const part = (name) => (this[name] = h("div", { class: name }));
    this.heading = h("h1");
    this.notice = h("p", { class: "notice warn small", hidden: true });
    this.headline = h(
      "header",
      { class: "summary headline floating" },
      this.heading,
      part("standing"),
      part("trouble"),
      this.notice,
    );
    this.element = h(
      "section",
      { class: "overview", "aria-labelledby": "overview" },
      h("h2", { id: "overview" }, "Overview"),
      part("facts"),
      part("figures"),
      part("buttons"),
    );
  }

  /** @param {object} job as it is now. */
  update(job) {
    this.heading.textContent = jobName(job);
    const { progress, state } = job;
    this.#part("facts", [job.name, job.created_at, job.outcome?.particle_count], () =>
      h(
        "p",
        { class: "quiet small" },
        [
          job.name && jobShapes(job),
          `method ${job.method}`,
          job.outcome && `${count(job.outcome.particle_count)} particles`,
          `submitted ${when(job.created_at)}`,
        ]
          .filter(Boolean)
          .join(" · "),
      ),
    );
    if (!shared()) this.#part("buttons", [state], () => [
      actions(job, this.changed),
      h(
        "div",
        { class: "row" },
        h("button", { type: "button", class: "compact", on: { click: () => this.#compare(job).catch((error) => fill(this.trouble, problemNotice(error))) } }, "Compare with…"),
      ),
    ]);
    this.#part("standing", [state, progress, job.queue_position], () => standing(job));
    this.#part("figures", [job.outcome, progress], () => figures(job));
    this.#part("trouble", [job.problem], () => job.problem && problemOf(job));
  }

  /** Say quietly that the service is gone, or nothing. */
  connection(there) {
    if (this.notice.hidden === there) return;
    this.notice.hidden = there;
    this.notice.textContent = there ? "" : GONE;
    announce(there ? "The service is back." : GONE);
  }

  #part(name, from, make) {
    redraw(this.drawn, name, this[name], from, make);
  }

  async #compare(job) {
    const { items } = await get("/jobs", { query: { limit: 50 }, signal: this.signal });
    const others = items.filter((one) => one.id !== job.id);
    const boxes = [];
    const most = () => {
      const chosen = boxes.filter((box) => box.checked).length;
      for (const box of boxes) box.disabled = chosen >= MAX_COMPARED - 1 && !box.checked;
      open.disabled = chosen === 0;
    };
    const open = h("button", { class: "primary", value: "compare", disabled: true }, "Compare");
    const dialog = h(
      "dialog",
      { "aria-labelledby": "compare-title" },
      h(
        "form",
        { method: "dialog", class: "stack" },
        h("h2", { id: "compare-title" }, "Compare with"),
        h("p", { class: "quiet small" }, "Choose up to three jobs."),
        h(
          "div",
          { class: "compare-choices" },
          others.length === 0 && h("p", null, "There are no other jobs yet."),
          others.map((other) => {
            const box = h("input", { type: "checkbox", value: other.id, on: { change: most } });
            boxes.push(box);
            return h(
              "label",
              { class: "choice" },
              box,
              h("span", null, jobName(other), h("span", { class: "quiet small" }, ` ${other.method}, ${word(other.state)}`)),
            );
          }),
        ),
        h("div", { class: "actions" }, h("button", { value: "" }, "Close"), open),
      ),
    );
    document.body.append(dialog);
    this.signal.addEventListener("abort", () => dialog.remove(), { once: true });
    dialog.addEventListener("close", () => {
      const ids = boxes.filter((box) => box.checked).map((box) => box.value);
      dialog.remove();
      if (dialog.returnValue === "compare" && ids.length) go(`/compare?jobs=${[job.id, ...ids].join(",")}`);
    });
    dialog.showModal();
  }
}

function standing(job) {
  const { progress, state } = job;
  const words = [h("span", { class: `badge ${state}` }, word(state))];
  if (state === "queued") words.push(place(job.queue_position));
  if (progress.frame > 0 || state === "running") {
    words.push(`${progress.frame} of ${plural(progress.frames, "frame")}`);
  }
  if (progress.stage) words.push(STAGES[progress.stage]);
  if (lives(state) && progress.seconds_left !== null) words.push(`about ${duration(progress.seconds_left)} left`);
  if (state === "succeeded" && job.started_at) {
    words.push(`in ${duration((new Date(job.finished_at) - new Date(job.started_at)) / 1000)}`);
  }
  return [
    h("p", { class: "row words small" }, words.map((text) => h("span", null, text))),
    lives(state) &&
      h("progress", { max: progress.frames, value: progress.frame, "aria-label": "Finished frames" }),
  ];
}

function figures({ outcome, progress }) {
  const metrics = outcome?.metrics ?? progress.metrics;
  const known = METRICS.filter(([name]) => name in metrics);
  if (!known.length) return null;
  return [
    h("h3", null, `Frame ${progress.frame}, the ${outcome ? "last" : "newest"}`),
    "spill" in metrics && h("p", null, filling(metrics)),
    h(
      "dl",
      { class: "numbers" },
      known.map(([name, label, unit]) =>
        h(
          "div",
          null,
          h("dt", { class: "quiet small" }, label),
          h("dd", null, number(metrics[name], 3), unit && h("span", { class: "quiet small" }, ` ${unit}`)),
        ),
      ),
    ),
  ];
}

function filling({ cover, spill }) {
  return `${percent(cover)} of the target is filled, and ${percent(spill)} of the matter lies outside it.`;
}

function place(position) {
  if (position === null) return "waits";
  return position === 0 ? "next in the queue" : `${plural(position, "job")} before it`;
}

function problemOf({ problem }) {
  return h(
    "div",
    { class: "notice bad" },
    h("p", null, inTitles(problem.cause)),
    problem.remedy && h("p", { class: "quiet" }, inTitles(problem.remedy)),
  );
}
