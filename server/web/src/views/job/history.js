/** What happened to a job, the newest first. */
import { fill, h } from "../../dom.js";
import { when } from "../../format.js";
import { sentence } from "./sentences.js";

const SHOWN = 200;

/** A list of events and of the stages of the job itself. */
export class History {
  constructor() {
    this.list = h("ol", { class: "history", reversed: true });
    this.element = h(
      "section",
      { class: "panel stack", "aria-labelledby": "history" },
      h("h2", { id: "history" }, "History"),
      this.list,
    );
    this.events = [];
    this.job = null;
  }

  /** @param {{events?: object[], job?: object}} news what is known now. */
  set(news) {
    Object.assign(this, news);
    const shown = JSON.stringify([this.events.length, this.job?.state, this.job?.progress.attempt]);
    if (!this.job || shown === this.shown) return;
    this.shown = shown;
    const { created_at: begun, finished_at: ended, state } = this.job;
    const all = [
      { type: "submitted", at: begun, data: {} },
      ...this.events.slice(-SHOWN),
      ended && { type: "state", at: ended, data: { state } },
    ].filter(Boolean);
    fill(
      this.list,
      all
        .reverse()
        .map((event) =>
          h(
            "li",
            { class: event.type },
            h("time", { datetime: event.at, class: "quiet small" }, when(event.at, "medium")),
            h("span", null, sentence(event)),
          ),
        ),
    );
  }
}
