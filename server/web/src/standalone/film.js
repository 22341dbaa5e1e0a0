/** Frames that came with the page: particles, and perhaps surfaces whose triangles stay the same. */
import { lightOf } from "../viewer/own_colors.js";

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
  const take = (Type, length) => new Type(buffer.slice(at, (at += length * Type.BYTES_PER_ELEMENT)));
  const summed = (Type, { count, frames, closes }) => {
    const levels = Array.from({ length: frames.length + closes }, () => take(Type, 3 * count));
    for (let i = 1; i < levels.length; i++) {
      for (let j = 0; j < levels[i].length; j++) levels[i][j] += levels[i - 1][j]; // modulo 65536, or 256
    }
    return { all: levels.slice(0, frames.length), end: levels[frames.length] };
  };
  const moving = (what) => ({ levels: summed(Uint16Array, what), colours: what.colored && summed(Uint8Array, what) });
  const points = { ...about.points, ...moving(about.points) };
  const surfaces = about.surfaces.map((surface) => ({
    ...surface,
    ...moving(surface),
    faces: take(Uint32Array, 3 * surface.triangles),
  }));
  return new Film(about, points, surfaces);
}

export class Film {
  constructor({ frames, offset, scale }, points, surfaces) {
    Object.assign(this, { count: frames.length, offset, scale, points, surfaces });
  }

  /**
   * @param {number} moment a frame, or the place between two.
   * @param {number} closing how far a loop has gone from its last frame to its first one, 0..1.
   * @returns {Float32Array} x y z of each particle.
   */
  positions(moment, closing = 0) {
    return this.#at(this.points, moment, closing);
  }

  /** @returns {Float32Array | null} linear colours of the particles, if they have any. */
  light(moment, closing = 0) {
    return this.#lightAt(this.points, moment, closing);
  }

  /** @returns {{vertices: Float32Array, faces: Uint32Array, light: Float32Array | null}} the surface at a moment. */
  surface(moment, closing = 0) {
    const surface = this.surfaces.findLast(({ frames }) => frames[0] <= moment) ?? this.surfaces[0];
    return {
      vertices: this.#at(surface, moment, closing),
      faces: surface.faces,
      light: this.#lightAt(surface, moment, closing),
    };
  }

  #lightAt({ colours, frames }, moment, closing) {
    if (!colours) return null;
    const [first, next, share] = around(colours.all, frames, moment);
    const light = lightOf(first, next, share);
    if (!closing || !colours.end) return light;
    const end = lightOf(colours.end, colours.end, 0);
    return light.map((value, i) => value + closing * (end[i] - value));
  }

  #at({ levels: { all, end }, frames }, moment, closing) {
    const [first, next, share] = around(all, frames, moment);
    const last = all.at(-1);
    const out = new Float32Array(first.length);
    for (let i = 0; i < out.length; i++) {
      let level = first[i] + share * (next[i] - first[i]);
      if (closing && end) level += closing * (end[i] - last[i]);
      out[i] = this.offset[i % 3] + (this.scale / LEVELS) * level;
    }
    return out;
  }
}

/** What there is of the frames on both sides of a moment, and how far it is from the first to the second. */
function around(all, frames, moment) {
  const within = Math.min(Math.max(moment - frames[0], 0), all.length - 1);
  return [all[Math.floor(within)], all[Math.ceil(within)], within % 1];
}
