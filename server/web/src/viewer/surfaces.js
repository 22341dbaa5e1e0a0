/** The surfaces of a job's frames, which the service computes when it is asked; each is asked for once. */
import { part } from "../part.js";

const BUDGET = 300e6; // bytes that all panels of a view hold; beyond it the oldest go

export class Surfaces {
  #held = new Map();
  #bytes = 0;
  #filling = null;

  /** @param {string} jobId @param {AbortSignal} signal @param {number} [share] of the budget. */
  constructor(jobId, signal, share = 1) {
    Object.assign(this, { jobId, signal, budget: share * BUDGET });
    this.full = false; // whether there is no room for those of all frames
    this.snap = false; // whether those of the first and last frames are snapped to the meshes
  }

  /** Have them snapped, or as computed. */
  set snapped(snap) {
    if (snap !== this.snap) this.clear();
    this.snap = snap;
  }

  /** @returns {number} how many are here. */
  get count() {
    return this.#held.size;
  }

  /** @returns {object | undefined} the surface of a frame, if it is here. */
  held(index) {
    return this.#held.get(index);
  }

  /** The surface of a frame [grid units], see meshes.js. */
  async get(index, signal = this.signal) {
    if (this.#held.has(index)) return this.#held.get(index);
    const { snap } = this;
    const { mesh } = await part(() => import("./meshes.js"));
    const path = `/jobs/${this.jobId}/frames/${index}/surface`;
    const found = await mesh(path, { query: { units: "grid", ...(snap && { snap }) }, signal });
    if (snap !== this.snap) return found; // which nobody wants any more
    if (!this.#held.has(index)) this.#keep(index, found); // which another may have asked for meanwhile
    return this.#held.get(index);
  }

  /**
   * Get those of all frames, one after the other, as long as there is room.
   *
   * @param {number} count of frames.
   * @param {(index: number, mesh: object) => void} prepare does beforehand what motion needs.
   */
  fill(count, prepare) {
    this.#filling ??= this.#getAll(count, prepare).finally(() => (this.#filling = null));
    return this.#filling;
  }

  clear() {
    this.#held.clear();
    this.#bytes = 0;
    this.full = false;
  }

  async #getAll(count, prepare) {
    try {
      for (let index = 0; index < count && !this.full; index++) prepare(index, await this.get(index));
    } catch {
      // the particles of these frames are shown
    }
  }

  #keep(index, mesh) {
    this.#held.set(index, mesh);
    this.#bytes += size(mesh);
    while (this.#bytes > this.budget && this.#held.size > 1) {
      this.full = true;
      const [oldest, one] = this.#held.entries().next().value;
      this.#held.delete(oldest);
      this.#bytes -= size(one);
    }
  }
}

/** Bytes of a surface with its normals, where they go, its colours and the particle of each vertex. */
function size({ vertices, faces, light }) {
  return (10 / 3) * vertices.byteLength + faces.byteLength + (light?.byteLength ?? 0);
}
