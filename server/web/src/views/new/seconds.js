/** How long a morph lasts, in place of how many frames are computed for it. */
import { fill, h } from "../../dom.js";
import { USUAL_RATE } from "../../viewer/timeline.js";

/** A field of seconds, as they pass when frames are played at the usual rate. */
export class Seconds {
  #legs = 1;

  /**
   * @param {number} mostFrames of a leg.
   * @param {(frames: number) => void} changed hears how many frames each leg is to have.
   */
  constructor(mostFrames, changed) {
    Object.assign(this, { mostFrames, changed, wrong: false });
    this.input = h("input", {
      type: "number",
      id: "seconds",
      inputmode: "decimal",
      min: 0,
      step: "any",
      autocomplete: "off",
      "aria-describedby": "seconds-hint seconds-fault",
      on: { change: () => this.#read() },
    });
    const words = "From the first shape to the last; playback can be faster or slower.";
    this.hint = h("p", { class: "hint", id: "seconds-hint" }, words);
    this.trouble = h("p", { class: "fault", id: "seconds-fault", role: "alert" });
    this.element = h(
      "div",
      { class: "field" },
      h("label", { for: "seconds" }, "Duration", h("span", { class: "quiet unit" }, " [s]")),
      this.input,
      h("div", { class: "hint-or-fault" }, this.hint, this.trouble),
    );
  }

  /** Show the time of so many frames a leg; what is typed and wrong stays to be mended. */
  show(frames, legs) {
    this.#legs = legs;
    if (this.wrong || document.activeElement === this.input) return;
    this.input.value = Number(secondsOf(frames * legs).toFixed(2));
  }

  #read() {
    const seconds = this.input.valueAsNumber;
    const most = secondsOf(this.mostFrames * this.#legs);
    this.wrong = !(seconds > 0 && seconds <= most);
    this.input.setAttribute("aria-invalid", String(this.wrong));
    this.hint.style.visibility = this.wrong ? "hidden" : "";
    fill(this.trouble, this.wrong && `Enter a number of seconds above 0 and at most ${Math.floor(most)}.`);
    if (!this.wrong) this.changed(Math.max(1, Math.round((seconds * USUAL_RATE) / this.#legs)));
  }
}

/** How long frames last when they are played at the usual rate [s]. */
function secondsOf(frames) {
  return frames / USUAL_RATE;
}
