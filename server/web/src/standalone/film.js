/** Frames that came with the page: particles, and perhaps surfaces whose triangles stay the same. */

const LEVELS = 65535;

/**
 * Unpack what the page holds.
 *
 * @param {object} about the document that describes it.
 * @param {string} packed its arrays one after the other, deflated, in base64.
 * @returns {Promise<Film>}
 */
export async function unpack(about, packed) {
  const bytes = await (await fetch(`data:application/octet-stream;base64,${packed}`)).arrayBuffer();
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  let at = 0;
  const take = (Type, length) => {
    const array = new Type(buffer.slice(at, (at += length * Type.BYTES_PER_ELEMENT)));
    return array;
  };
  const moving = ({ count, frames }) => {
    const levels = frames.map(() => take(Uint16Array, 3 * count));
    for (let i = 1; i < levels.length; i++) {
      for (let j = 0; j < levels[i].length; j++) levels[i][j] += levels[i - 1][j]; // modulo 65536
    }
    return levels;
  };
  const points = about.points && { ...about.points, levels: moving(about.points) };
  const surfaces = about.surfaces.map((surface) => ({
    ...surface,
    levels: moving(surface),
    faces: take(Uint32Array, 3 * surface.triangles),
  }));
  return new Film(about, points, surfaces);
}

export class Film {
  constructor({ frames, offset, scale }, points, surfaces) {
    Object.assign(this, { count: frames.length, offset, scale, points, surfaces });
  }

  /** @returns {Float32Array} x y z of each particle at a moment, which may lie between two frames. */
  positions(moment) {
    return this.#at(this.points, moment);
  }

  /** @returns {{vertices: Float32Array, faces: Uint32Array}} the surface at a moment. */
  surface(moment) {
    const surface = this.surfaces.findLast(({ frames }) => frames[0] <= moment) ?? this.surfaces[0];
    return { vertices: this.#at(surface, moment), faces: surface.faces };
  }

  #at({ levels, frames }, moment) {
    const within = Math.min(Math.max(moment - frames[0], 0), levels.length - 1);
    const first = levels[Math.floor(within)];
    const next = levels[Math.ceil(within)];
    const share = within % 1;
    const out = new Float32Array(first.length);
    for (let i = 0; i < out.length; i++) {
      out[i] = this.offset[i % 3] + (this.scale / LEVELS) * (first[i] + share * (next[i] - first[i]));
    }
    return out;
  }
}
