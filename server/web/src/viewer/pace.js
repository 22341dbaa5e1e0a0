/** The time in which a job is played, apart from how many frames it has. */
import { get } from "../api.js";
import { choice, offer } from "../choice.js";
import { h } from "../dom.js";

const RATES = [24, 25, 30, 60];
const USUAL_FPS = 30; // pictures a second, of films
const USUAL_SECONDS = 5;
const MOST_SECONDS = 3600;
const RESTS = [0, 0.5, 1, 2];
const PACES = [
  ["frames", "Frame by frame"],
  ["linear", "Even"],
  ["in-out", "Slow at each shape"],
  ["overshoot", "Overshoot"],
];
const REPEATS = [
  ["none", "Once"],
  ["ping-pong", "Ping-pong"],
  ["loop", "In a loop"], // where the last shape is the first one
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
    const change = () => this.#change();
    const named = (all, unit) => all.map((value) => [String(value), `${value} ${unit}`]);
    this.easing = choice("play-pace", "Pace", PACES, { change, title: "How evenly one shape turns into the next" });
    this.seconds = h("input", {
      type: "number",
      id: "play-seconds",
      inputmode: "decimal",
      min: 0.1,
      max: MOST_SECONDS,
      step: "any",
      required: true,
      title: "Seconds from the first frame to the last",
      value: USUAL_SECONDS,
      on: { change },
    });
    const lasts = h("label", { class: "small quiet", for: "play-seconds" }, "Duration [s]");
    const rates = { value: String(USUAL_FPS), change, title: "Frames per second, in recordings" };
    this.rate = choice("play-rate", "Frame rate", named(RATES, "fps"), rates);
    this.hold = choice("play-hold", "Pauses", named(RESTS, "s"), { change, title: "How long it pauses at each shape" });
    this.repeat = choice("play-repeat", "Repeat", REPEATS, { change, title: "Whether it plays back or starts again" });
    this.timed = [h("div", { class: "field" }, lasts, this.seconds), this.rate.field, this.hold.field, this.repeat.field];
    this.trouble = h("p", { class: "small fault", role: "alert" });
    this.element = h(
      "div",
      { class: "stack", hidden: true },
      this.easing.field,
      ...this.timed,
      this.trouble,
    );
    this.#reflect();
  }

  /** @param {object} job which has a time to choose once its result is there. */
  offer({ state, source, target }) {
    const there = state === "succeeded";
    const closed = JSON.stringify(source) === JSON.stringify(target);
    offer(this.repeat.select, (name) => name !== "loop" || closed);
    this.element.hidden = !there;
    if (there || this.easing.select.value === "frames") return;
    this.easing.select.value = "frames";
    this.#change();
  }

  /** @returns {object | null} the playing time as requests have it; null where each frame is shown as long. */
  get request() {
    const easing = this.easing.select.value;
    if (easing === "frames") return null;
    return {
      easing,
      seconds: this.seconds.valueAsNumber,
      hold: Number(this.hold.select.value),
      repeat: this.repeat.select.value,
      fps: Number(this.rate.select.value),
    };
  }

  async #change() {
    this.#reflect();
    this.trouble.textContent = "";
    const own = (this.asked = {});
    const query = this.request;
    if (!query) return this.timeline.setPace(null);
    if (!this.seconds.checkValidity()) {
      this.trouble.textContent = `Enter a number of seconds from 0.1 to ${MOST_SECONDS}.`;
      return;
    }
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
    for (const field of this.timed) field.hidden = frames;
  }
}
