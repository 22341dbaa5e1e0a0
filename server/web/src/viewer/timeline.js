/** Frames in time: play, step, scrub, follow the newest one. */
import { h } from "../dom.js";
import { icon, iconButton } from "../icons.js";

const RATES = [4, 8, 12, 24, 48];

/** Frames a second at which a job is played until somebody chooses otherwise. */
export const USUAL_RATE = 12;

/** However long the page stood still, playing skips no more than this. */
const LONGEST_STEP_MILLISECONDS = 250;

/** A timeline; it follows the newest frame until the user chooses one. */
export class Timeline {
  #turn = 0;

  /**
   * @param {object} options
   * @param {(index: number, how: {playing: boolean}) => Promise<void>} options.show resolves once the frame is
   *   to be seen.
   * @param {(share: number) => void} options.between shows what is on its way from this frame to the next.
   * @param {(index: number | null) => void} [options.onRest] hears which frame the user stays at; null for the
   *   newest, whichever that is.
   * @param {AbortSignal} options.signal
   */
  constructor({ show, between, onRest = () => {}, signal }) {
    Object.assign(this, { show, between, onRest, signal });
    this.index = -1;
    this.count = 0;
    this.following = true;
    this.playing = false;
    this.moving = false; // whether what is shown is a part of a motion
    this.share = 0; // of the way from this frame to the next that is shown
    this.closing = 0; // how far a loop has gone from its last frame to its first one
    this.pace = null;

    this.toggle = iconButton("Play", "play", () => (this.playing ? this.rest() : this.play()), { key: "Space" });
    this.toggle.classList.add("primary");
    this.range = h("input", {
      type: "range",
      min: 0,
      max: 0,
      value: 0,
      disabled: true,
      "aria-label": "Frame",
      title: "Frame (← →)",
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
      { value: String(USUAL_RATE), "aria-label": "Speed", title: "Frames per second" },
      RATES.map((rate) => h("option", { value: rate }, `${rate}/s`)),
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
      { class: "timeline floating", role: "group", "aria-label": "Timeline" },
      h(
        "div",
        { class: "row steps" },
        iconButton("Previous frame", "back", () => this.step(-1), { key: "←" }),
        this.toggle,
        iconButton("Next frame", "forward", () => this.step(1), { key: "→" }),
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

  /**
   * Play in a time of its own, apart from how many frames there are.
   *
   * @param {{fps: number, frames: number[], repeat: boolean, closing?: number[]} | null} pace the frame, or the
   *   place between two, of each picture, and how far a loop has closed by then; null for each frame as long as the
   *   others.
   */
  setPace(pace) {
    const playing = this.playing;
    this.stop();
    this.pace = pace;
    this.rate.hidden = pace !== null;
    if (pace?.repeat) this.loop.checked = true;
    if (playing) this.play();
  }

  /** The moment of a picture of the pace, which may lie between two pictures. */
  momentAt(picture) {
    if (!this.pace) return picture;
    return Math.min(between(this.pace.frames, picture), this.count - 1);
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
    this.onRest(index);
  }

  /** @param {number} by so many frames on, or back; to the ends at most. */
  step(by) {
    if (this.count) this.choose(Math.min(Math.max(this.index + by, 0), this.count - 1));
  }

  setFollowing(following) {
    this.following = following;
    this.stop();
    if (following && this.count) this.go(this.count - 1);
    this.onRest(following ? null : this.index);
    this.#reflect();
  }

  /** Play from here, or from the beginning if this is the end; between frames what moves is shown on its way. */
  async play() {
    if (this.count < 2) return;
    const turn = ++this.#turn;
    this.playing = true;
    this.following = false;
    this.#reflect();
    let at = this.index >= this.count - 1 ? 0 : this.index; // in pictures of the pace, or in frames
    if (this.pace) at = Math.max(0, this.pace.frames.findIndex((moment) => moment >= at));
    while (turn === this.#turn && !this.signal.aborted) {
      await this.at(this.momentAt(at), this.pace?.closing ? between(this.pace.closing, at) : 0);
      const shown = performance.now(); // the clock rests while something is awaited
      await new Promise(requestAnimationFrame);
      const last = (this.pace ? this.pace.frames.length : this.count) - 1;
      if (at >= last && !this.loop.checked) break;
      const passed = Math.min(performance.now() - shown, LONGEST_STEP_MILLISECONDS);
      at += (passed / 1000) * (this.pace ? this.pace.fps : Number(this.rate.value));
      if (!this.loop.checked) at = Math.min(at, last);
      else if (at >= last + 1) at = 0; // the last frame lasts as long as the others
    }
    if (turn === this.#turn) this.rest();
  }

  /** Show a moment, which may lie between two frames, as a part of a motion, in which a loop may close. */
  async at(moment, closing = 0) {
    const index = Math.floor(moment);
    this.closing = closing;
    if (index !== this.index || !this.moving) {
      this.moving = true;
      await this.#show(index, { playing: true });
    }
    const share = moment - index;
    if (share || this.share) this.between(share);
    this.share = share;
  }

  /** Stop, and stay at a whole frame. */
  rest() {
    this.stop();
    this.go(this.index);
    this.onRest(this.index);
  }

  stop() {
    this.#turn += 1;
    this.playing = false;
    this.#reflect();
  }

  /** Show a frame. */
  go(index) {
    this.moving = false;
    this.closing = 0;
    return this.#show(index, { playing: false });
  }

  #show(index, how) {
    this.index = index;
    this.share = 0;
    this.#reflect();
    return index < 0 ? Promise.resolve() : this.show(index, how);
  }

  #reflect() {
    this.range.value = Math.max(0, this.index);
    const text = this.count ? `${this.index + 1} / ${this.count}` : "–";
    this.reading.textContent = text;
    this.range.setAttribute("aria-valuetext", `Frame ${this.index + 1} of ${this.count}`);
    this.toggle.disabled = this.count < 2;
    this.follow.setAttribute("aria-pressed", String(this.following));
    const [label, name] = this.playing ? ["Pause", "pause"] : ["Play", "play"];
    if (this.toggle.getAttribute("aria-label") === label) return;
    this.toggle.setAttribute("aria-label", label);
    this.toggle.title = `${label} (Space)`;
    this.toggle.replaceChildren(icon(name));
  }
}

/** The value at a picture, which may lie between two. */
function between(values, picture) {
  const before = Math.min(Math.floor(picture), values.length - 1);
  const after = Math.min(before + 1, values.length - 1);
  return values[before] + (picture - before) * (values[after] - values[before]);
}
