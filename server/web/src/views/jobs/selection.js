/** Two to four jobs that are to be compared. */

import { fill, h } from "../../dom.js";
import { jobName } from "../../format.js";
import { MAX_COMPARED } from "../compare/max_compared.js";

/** What is chosen, and the bar that leads to the comparison. */
export class Selection {
  constructor() {
    this.boxes = new Map();
    this.chosen = new Set();
    this.element = h("div", { class: "selection", role: "status", hidden: true });
  }

  /** The checkbox of a job. */
  box(job) {
    const change = (event) => {
      if (event.target.checked) this.chosen.add(job.id);
      else this.chosen.delete(job.id);
      this.draw();
    };
    const input = h("input", {
      type: "checkbox",
      "aria-label": `Compare ${jobName(job)}`,
      disabled: this.chosen.size >= MAX_COMPARED,
      on: { change },
    });
    this.boxes.set(job.id, input);
    return h("label", { class: "box" }, input);
  }

  /** A job that is no longer listed. */
  drop(id) {
    this.boxes.delete(id);
    if (this.chosen.delete(id)) this.draw();
  }

  draw() {
    const size = this.chosen.size;
    this.element.hidden = size === 0;
    for (const [id, box] of this.boxes) box.disabled = size >= MAX_COMPARED && !this.chosen.has(id);
    const clear = () => {
      for (const id of this.chosen) this.boxes.get(id).checked = false;
      this.chosen.clear();
      this.draw();
      document.querySelector(".job-table input")?.focus();
    };
    fill(
      this.element,
      h("span", null, size === 1 ? "1 selected; select up to three more." : `${size} selected`),
      h("button", { class: "plain compact", type: "button", on: { click: clear } }, "Clear"),
      size > 1 &&
        h(
          "a",
          { class: "button primary compact", href: `/compare?jobs=${[...this.chosen].join(",")}` },
          "Compare",
        ),
    );
  }
}
