/** Frames in time: play, step, scrub, follow the newest one. */
import { h, svg } from "../dom.js";
import { pause } from "../api.js";

const RATES = [4, 8, 12, 24, 48];
const USUAL_RATE = 12;
const ICONS = {
  play: "M4 2.5v11l9-5.5z",
  pause: "M4 2.5h3v11H4zM9 2.5h3v11H9z",
  back: "M10.5 2.5 5 8l5.5 5.5",
  forward: "M5.5 2.5 11 8l-5.5 5.5",
};

/** A timeline; it follows the newest frame until the user chooses one. */
export class Timeline {
  #turn = 0;

  /**
   * @param {{show: (index: number) => Promise<void>, signal: AbortSignal}} options `show` resolves
   *   once the frame is to be seen.
   */
  constructor({ show, signal }) {
    this.show = show;
    this.signal = signal;
    this.index = -1;
    this.count = 0;
    this.following = true;
    this.playing = false;

    this.toggle = button("Play", "play", () => (this.playing ? this.stop() : this.play()));
    this.toggle.classList.add("primary");
    this.range = h("input", {
      type: "range",
      min: 0,
      max: 0,
      value: 0,
      disabled: true,
      "aria-label": "Frame",
      on: {
        input: () => this.choose(Number(this.range.value)),
        keydown: (event) => {
          if (event.key !== " ") return;
          event.preventDefault();
          this.toggle.click();
        },
      },
    });
    this.reading = h("output", { class: "reading", "aria-live": "off" });
    this.rate = h(
      "select",
      { value: String(USUAL_RATE), "aria-label": "Speed" },
      RATES.map((rate) => h("option", { value: rate }, `${rate} frames/s`)),
    );
    this.loop = h("input", { type: "checkbox" });
    this.follow = h(
      "button",
      { type: "button", class: "compact", "aria-pressed": "true", hidden: true },
      "Newest frame",
    );
    this.follow.addEventListener("click", () => this.setFollowing(!this.following));
    this.element = h(
      "div",
      { class: "timeline", role: "group", "aria-label": "Timeline" },
      h(
        "div",
        { class: "row steps" },
        button("One frame back", "back", () => this.step(-1)),
        this.toggle,
        button("One frame on", "forward", () => this.step(1)),
      ),
      this.range,
      this.reading,
      h(
        "div",
        { class: "row settings" },
        this.follow,
        this.rate,
        h("label", { class: "choice" }, this.loop, "Loop"),
      ),
    );
    this.#reflect();
  }

  /** @param {number} count of frames there are @param {boolean} lives whether more may come */
  grow(count, lives = false) {
    const more = count !== this.count;
    this.count = count;
    this.follow.hidden = !lives;
    this.range.max = Math.max(0, count - 1);
    this.range.disabled = count === 0;
    if (more && count && this.following && !this.playing) this.go(count - 1);
    else if (this.index >= count) this.go(count - 1);
    else this.#reflect();
  }

  /** Show a frame because the user wants it. */
  choose(index) {
    this.stop();
    this.following = false;
    this.go(index);
  }

  step(by) {
    if (this.count) this.choose(Math.min(Math.max(this.index + by, 0), this.count - 1));
  }

  setFollowing(following) {
    this.following = following;
    this.stop();
    if (following && this.count) this.go(this.count - 1);
    this.#reflect();
  }

  /** Play from here, or from the beginning if this is the end. */
  async play() {
    if (this.count < 2) return;
    const turn = ++this.#turn;
    this.playing = true;
    this.following = false;
    this.#reflect();
    let next = this.index >= this.count - 1 ? 0 : this.index + 1;
    while (turn === this.#turn && !this.signal.aborted) {
      const due = performance.now() + 1000 / Number(this.rate.value);
      await this.go(next);
      await pause(Math.max(0, due - performance.now()), this.signal);
      if (next >= this.count - 1 && !this.loop.checked) break;
      next = next >= this.count - 1 ? 0 : next + 1;
    }
    if (turn === this.#turn) this.stop();
  }

  stop() {
    this.#turn += 1;
    this.playing = false;
    this.#reflect();
  }

  /** Show a frame. */
  go(index) {
    this.index = index;
    this.#reflect();
    return index < 0 ? Promise.resolve() : this.show(index);
  }

  #reflect() {
    this.range.value = Math.max(0, this.index);
    const text = this.count ? `${this.index + 1} / ${this.count}` : "–";
    this.reading.textContent = text;
    this.range.setAttribute("aria-valuetext", `Frame ${this.index + 1} of ${this.count}`);
    this.toggle.disabled = this.count < 2;
    this.follow.setAttribute("aria-pressed", String(this.following));
    const [label, icon] = this.playing ? ["Pause", "pause"] : ["Play", "play"];
    if (this.toggle.getAttribute("aria-label") === label) return;
    this.toggle.setAttribute("aria-label", label);
    this.toggle.replaceChildren(drawing(icon));
  }
}

function button(label, icon, act) {
  return h(
    "button",
    { type: "button", class: "icon", "aria-label": label, on: { click: act } },
    drawing(icon),
  );
}

function drawing(icon) {
  const line = icon === "back" || icon === "forward";
  return svg(
    "svg",
    { viewBox: "0 0 16 16", width: 16, height: 16, "aria-hidden": "true" },
    svg("path", {
      d: ICONS[icon],
      fill: line ? "none" : "currentColor",
      stroke: line ? "currentColor" : "none",
      "stroke-width": 2,
    }),
  );
}
