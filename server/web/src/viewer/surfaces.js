/** The surfaces of a job's frames, which the service computes when it is asked; each is asked for once. */
const BUDGET = 300e6; // bytes held; beyond it the oldest go

export class Surfaces {
  #held = new Map();
  #bytes = 0;
  #filling = null;

  /** @param {string} jobId @param {AbortSignal} signal */
  constructor(jobId, signal) {
    Object.assign(this, { jobId, signal });
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
    if (!this.#held.has(index)) {
      const { mesh } = await import("./meshes.js");
      const path = `/jobs/${this.jobId}/frames/${index}/surface`;
      this.#keep(index, await mesh(path, { query: { units: "grid" }, signal }));
    }
    return this.#held.get(index);
  }

  /**
   * Get those of all frames, one after the other.
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
  }

  async #getAll(count, prepare) {
    try {
      for (let index = 0; index < count && this.#bytes < BUDGET; index++) prepare(index, await this.get(index));
    } catch {
      // the particles of these frames are shown
    }
  }

  #keep(index, mesh) {
    this.#held.set(index, mesh);
    this.#bytes += size(mesh);
    while (this.#bytes > BUDGET && this.#held.size > 1) {
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
