/** Finished morphs as pictures; a click opens one. */
import { get, picture } from "../../api.js";
import { fill, h } from "../../dom.js";
import { ago, jobName, plural } from "../../format.js";
import { setTitle } from "../../navigation.js";
import { problemNotice } from "../../problem_notice.js";
import "./gallery.css";

const PAGE = 24;

/** Show a page of them, the newest first. */
export async function show(root, { cursor }, signal) {
  setTitle("Gallery");
  const page = await get("/jobs", { query: { state: "succeeded", limit: PAGE, cursor }, signal });
  const cards = page.items.map(card);
  fill(
    root,
    h(
      "div",
      { class: "stack gallery" },
      h(
        "div",
        { class: "spread" },
        h("h1", null, "Gallery"),
        h("a", { class: "button primary", href: "/new" }, "New morph"),
      ),
      cards.length === 0 && h("p", { class: "quiet" }, "No morph has succeeded yet."),
      h("ul", { class: "cards" }, cards.map(({ element }) => element)),
      pages(cursor, page.next_cursor),
    ),
  );
  try {
    await Promise.all(cards.map(({ draw }) => draw(signal)));
  } catch (error) {
    if (signal.aborted) return;
    if (error.name !== "Problem") throw error;
    root.firstChild.append(problemNotice(error));
  }
}

/** A morph: `element`, and `draw`, which fetches its picture. */
function card(job) {
  const frame = h("span", { class: "frame" });
  const facts = [job.method, plural(job.progress.frame, "frame"), ago(job.finished_at), job.owner && `by ${job.owner}`];
  const element = h(
    "li",
    null,
    h(
      "a",
      { href: `/jobs/${job.id}` },
      frame,
      h("span", { class: "name" }, jobName(job)),
      h("span", { class: "quiet small" }, facts.filter(Boolean).join(" · ")),
    ),
  );
  const draw = async (signal) => {
    try {
      const url = await picture(`/jobs/${job.id}/thumbnail`, { signal });
      signal.addEventListener("abort", () => URL.revokeObjectURL(url), { once: true });
      fill(frame, h("img", { src: url, alt: "", width: 240, height: 180 }));
    } catch (error) {
      if (error.status !== 404 && !signal.aborted) throw error; // it was deleted meanwhile
    }
  };
  return { element, draw };
}

function pages(cursor, next) {
  return (
    (cursor || next) &&
    h(
      "nav",
      { class: "row paging", "aria-label": "Pages" },
      cursor && h("a", { class: "button", href: "/gallery" }, "Newest"),
      next && h("a", { class: "button", href: `/gallery?cursor=${encodeURIComponent(next)}` }, "Older"),
    )
  );
}
