/** The frames of a job as they travel, 6 bytes a particle, fetched before they are asked for. */
import { binary, pause } from "../api.js";

const AT_ONCE = 4;
const BUDGET = 220e6; // bytes that all panels of a view hold; beyond it the frames farthest from the one shown go
const RETRY_MILLISECONDS = 1000;
const SLOWEST_MILLISECONDS = 30_000;

/** Frames 0 to `known` - 1 of a job; the newest is fetched first, then its neighbours. */
export class Frames {
  #held = new Map();
  #running = new Set();
  #waiting = new Map();
  #faults = new Map(); // of frames that cannot be had: what is wrong, and how long the next try waits
  #buffer = new Float32Array(0);

  /**
   * @param {string} jobId
   * @param {{signal: AbortSignal, share?: number, onArrival?: (index: number) => void}} options `share` is
   *   that of the budget.
   */
  constructor(jobId, { signal, share = 1, onArrival = () => {} }) {
    this.jobId = jobId;
    this.signal = signal;
    this.budget = share * BUDGET;
    this.onArrival = onArrival;
    this.known = 0;
    this.near = -1; // where the user looks, or is about to; before that, the newest
    this.generation = 0;
  }

  /** @returns {number} how many are here. */
  get count() {
    return this.#held.size;
  }

  /** @returns {number} bytes that they take. */
  get bytes() {
    let sum = 0;
    for (const frame of this.#held.values()) sum += frame.levels.byteLength;
    return sum;
  }

  has(index) {
    return this.#held.has(index);
  }

  /** @returns {string} why a frame has not come; empty as long as nothing is wrong. */
  trouble(index) {
    return this.#faults.get(index)?.message ?? "";
  }

  /** Tell that there are so many frames now. */
  grow(count) {
    if (count <= this.known) return;
    this.known = count;
    if (this.near < 0) this.near = count - 1;
    this.#fetch();
  }

  /** Forget everything: the job began anew. */
  clear() {
    this.generation += 1;
    this.#held.clear();
    this.#running.clear();
    this.#faults.clear();
    this.known = 0;
    this.near = -1;
  }

  /** Look at a frame: it and what is around it come first. */
  look(index) {
    this.near = index;
    this.#fetch();
  }

  /**
   * Wait for a frame.
   *
   * @returns {Promise<boolean>} whether it came; false once the signal aborts.
   */
  async wait(index) {
    this.look(index);
    while (!this.has(index) && !this.signal.aborted && index < this.known) {
      await new Promise((resolve) => {
        this.#waiting.set(index, [...(this.#waiting.get(index) ?? []), resolve]);
        this.signal.addEventListener("abort", resolve, { once: true });
      });
    }
    return this.has(index);
  }

  /**
   * Positions of a frame that is here.
   *
   * @param {number} index
   * @param {Float32Array} [into] a buffer of one's own; without it, one that the next call reuses.
   * @returns {Float32Array | null} x y z of each particle [grid units].
   */
  positions(index, into) {
    const frame = this.#held.get(index);
    if (!frame) return null;
    const { levels, offset, scale } = frame;
    if (!into && this.#buffer.length !== levels.length) {
      this.#buffer = new Float32Array(levels.length);
    }
    const out = into ?? this.#buffer;
    for (let i = 0; i < levels.length; i++) out[i] = offset + scale * levels[i];
    return out;
  }

  /**
   * Positions between a frame and the next one, both of which are here.
   *
   * @param {number} share of the way to the next one, 0..1.
   * @returns {Float32Array | null} as `positions` does, in a buffer that the next call reuses.
   */
  between(index, share) {
    const next = this.#held.get(index + 1);
    const out = next && this.positions(index);
    if (!out || next.levels.length !== out.length) return null;
    const { levels, offset, scale } = next;
    for (let i = 0; i < out.length; i++) out[i] += share * (offset + scale * levels[i] - out[i]);
    return out;
  }

  #fetch() {
    // the first frame alone, since several at once would share out the way
    while (this.#running.size < (this.#held.size ? AT_ONCE : 1) && !this.signal.aborted) {
      const index = this.#next();
      if (index === null) return;
      this.#running.add(index);
      this.#get(index, this.generation);
    }
  }

  /** The missing frame nearest to the one looked at; the ones after it first. */
  #next() {
    const wanted = (index) =>
      index >= 0 && index < this.known && !this.#held.has(index) && !this.#running.has(index);
    const room = this.#held.size ? this.budget / (this.bytes / this.#held.size) : Infinity;
    const reach = Math.min(this.known, Math.max(1, Math.floor(room / 2)));
    for (let distance = 0; distance < reach; distance++) {
      if (wanted(this.near + distance)) return this.near + distance;
      if (wanted(this.near - distance)) return this.near - distance;
    }
    return null;
  }

  async #get(index, generation) {
    try {
      const { buffer, headers } = await binary(`/jobs/${this.jobId}/frames/${index}`, {
        query: { format: "u16" },
        signal: this.signal,
      });
      if (generation !== this.generation) return;
      this.#held.set(index, {
        levels: new Uint16Array(buffer),
        offset: Number(headers.get("Morph-Offset")),
        scale: Number(headers.get("Morph-Scale")),
      });
      this.#faults.delete(index);
      this.#evict();
      this.onArrival(index);
      for (const resolve of this.#waiting.get(index) ?? []) resolve();
      this.#waiting.delete(index);
    } catch (error) {
      if (generation === this.generation) await this.#rest(index, error);
    } finally {
      if (generation === this.generation) {
        this.#running.delete(index);
        this.#fetch();
      }
    }
  }

  /** Wait before a frame is asked for again: the longer, the more often it has been refused. */
  #rest(index, { message, status }) {
    const refused = status && status !== 429; // else the service may be starting again
    const wait = refused ? (this.#faults.get(index)?.next ?? RETRY_MILLISECONDS) : RETRY_MILLISECONDS;
    this.#faults.set(index, { message, next: Math.min(2 * wait, SLOWEST_MILLISECONDS) });
    return pause(wait, this.signal);
  }

  #evict() {
    while (this.bytes > this.budget && this.#held.size > 1) {
      const farthest = [...this.#held.keys()].reduce((a, b) =>
        Math.abs(a - this.near) > Math.abs(b - this.near) ? a : b,
      );
      this.#held.delete(farthest);
    }
  }
}
