/** The time in which a job is played, apart from how many frames it has. */
import { get } from "../api.js";
import { h } from "../dom.js";

const PICTURES_PER_SECOND = 30;
const SECONDS = [2, 3, 5, 8, 12, 20];
const USUAL_SECONDS = 5;
const PACES = [
  ["frames", "Frame by frame"],
  ["linear", "Even"],
  ["in-out", "Slow at each shape"],
  ["overshoot", "Past each shape and back"],
];
const REPEATS = [
  ["none", "Once"],
  ["ping-pong", "There and back"],
];

/** Controls of the playing time of one job; which frame is shown when is the service's to say. */
export class Pace {
  /**
   * @param {object} options
   * @param {string} options.jobId
   * @param {import("./timeline.js").Timeline} options.timeline
   * @param {AbortSignal} options.signal
   */
  constructor({ jobId, timeline, signal }) {
    Object.assign(this, { jobId, timeline, signal });
    this.easing = this.#choice("pace", "Pace", PACES, "frames");
    this.seconds = this.#choice("seconds", "Lasts", SECONDS.map((s) => [String(s), `${s} s`]), String(USUAL_SECONDS));
    this.repeat = this.#choice("repeat", "Played", REPEATS, "none");
    this.trouble = h("p", { class: "small fault", role: "alert" });
    this.element = h(
      "div",
      { class: "stack", hidden: true },
      this.easing.field,
      this.seconds.field,
      this.repeat.field,
      this.trouble,
    );
    this.#reflect();
  }

  /** @param {boolean} there whether the job has its result, without which there is no time to choose. */
  offer(there) {
    this.element.hidden = !there;
    if (there || this.easing.select.value === "frames") return;
    this.easing.select.value = "frames";
    this.#change();
  }

  async #change() {
    this.#reflect();
    this.trouble.textContent = "";
    const own = (this.asked = {});
    const easing = this.easing.select.value;
    if (easing === "frames") return this.timeline.setPace(null);
    const query = {
      easing,
      seconds: this.seconds.select.value,
      repeat: this.repeat.select.value,
      fps: PICTURES_PER_SECOND,
    };
    try {
      const pace = await get(`/jobs/${this.jobId}/playback`, { query, signal: this.signal });
      if (this.asked === own) this.timeline.setPace(pace);
    } catch (error) {
      if (this.signal.aborted) return;
      if (error.name !== "Problem") throw error;
      if (this.asked === own) this.trouble.textContent = `${error.message} ${error.remedy ?? ""}`;
    }
  }

  #reflect() {
    const frames = this.easing.select.value === "frames";
    this.seconds.field.hidden = this.repeat.field.hidden = frames;
  }

  #choice(name, label, options, value) {
    const id = `play-${name}`;
    const select = h(
      "select",
      { id, on: { change: () => this.#change() } },
      options.map(([option, text]) => h("option", { value: option }, text)),
    );
    select.value = value;
    return { select, field: h("div", { class: "field" }, h("label", { class: "small", for: id }, label), select) };
  }
}
