/**
 * How finely is drawn: as finely as this machine manages in time, by what its own pictures took.
 *
 * Each level is tried once the one below it was quick enough to promise that. In motion a graphics card may take
 * 18 ms for a picture (50 a second and time to show it), a processor 40 ms (25 a second); at rest either may take
 * 400 ms. Where even a sketch takes longer, a sketch it is.
 */

/** From quick to fine; `growth` is how much longer than the level below it may take. */
export const LEVELS = [
  { name: "sketch", label: "Sketch" }, // half the pixels each way, a part of the particles, a matcap for light
  { name: "plain", label: "Plain", growth: 4 }, // all pixels and particles
  { name: "full", label: "Full", growth: 4 }, // with ambient occlusion, refraction, fine pixels
];

const MOVING = { card: 18, processor: 40 }; // [ms]
const STILL = 400;
const SAMPLES = 3; // of which the quickest counts, as the first one compiles
const AGAIN = 30; // one picture in so many is measured once enough is known

/** Judges from measured times; `chosen` overrides it. */
export class Quality {
  #times = new Map();
  #drawn = 0;

  /** @param {boolean} software whether the processor draws, as there is no graphics card. */
  constructor(software) {
    this.chosen = "auto";
    this.budget = { moving: software ? MOVING.processor : MOVING.card, still: STILL };
  }

  /** @returns {number} the level for a picture of a kind of thing, in motion or at rest. */
  level(kind, motion) {
    if (this.chosen !== "auto") return LEVELS.findIndex(({ name }) => name === this.chosen);
    let level = 0;
    while (level + 1 < LEVELS.length && this.#expected(kind, level + 1) <= this.budget[motion]) level += 1;
    return level;
  }

  /** Whether the next picture is to be measured, which makes the page wait for it. */
  measures(kind, level) {
    this.#drawn += 1;
    return this.#of(kind, level).length < SAMPLES || this.#drawn % AGAIN === 0;
  }

  /** @param {number} milliseconds that a picture took. */
  took(kind, level, milliseconds) {
    const times = this.#of(kind, level);
    times.push(milliseconds);
    if (times.length > SAMPLES) times.shift();
  }

  /** Whether a finer picture may follow once more is known. */
  learns(kind, level) {
    return this.chosen === "auto" && this.#of(kind, level).length < SAMPLES;
  }

  /** Judge anew, as after a change of size. */
  forget() {
    this.#times.clear();
  }

  #expected(kind, level) {
    const times = this.#of(kind, level);
    if (times.length >= SAMPLES) return Math.min(...times);
    return level === 0 ? Infinity : LEVELS[level].growth * this.#expected(kind, level - 1);
  }

  #of(kind, level) {
    const key = `${kind} ${level}`;
    if (!this.#times.has(key)) this.#times.set(key, []);
    return this.#times.get(key);
  }
}
