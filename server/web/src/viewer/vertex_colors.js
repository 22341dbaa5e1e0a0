/** Colours of a surface's vertices, from those of the particles nearest to them. */

import { NONE } from "./nearest.js";
import { LEVELS, palette } from "./palettes.js";

/**
 * Colours by values of the particles, linear as the lights need them.
 *
 * @param {Float32Array} values one per particle.
 * @param {{low: number, high: number, palette: string}} scale
 * @param {Uint32Array} near the particle of each vertex, see nearest.js.
 * @param {import("three").Color} plain where no particle is near, or its value is unknown.
 * @returns {Float32Array} three for each vertex, 0..1.
 */
export function byValue(values, { low, high, palette: name }, near, plain) {
  const table = palette(name);
  const linear = (level) => {
    const shade = level / 255;
    return shade <= 0.04045 ? shade / 12.92 : ((shade + 0.055) / 1.055) ** 2.4;
  };
  const shades = Float32Array.from(table, linear);
  const out = new Float32Array(3 * near.length);
  for (let v = 0; v < near.length; v++) {
    const value = near[v] === NONE ? NaN : values[near[v]];
    if (Number.isNaN(value)) {
      plain.toArray(out, 3 * v);
      continue;
    }
    const share = Math.min(Math.max((value - low) / Math.max(high - low, 1e-9), 0), 1);
    const level = 4 * Math.round(share * (LEVELS - 1));
    out.set(shades.subarray(level, level + 3), 3 * v);
  }
  return out;
}

/**
 * The own colour of each vertex's particle.
 *
 * @param {Float32Array} light linear, three for each particle.
 * @param {Uint32Array} near the particle of each vertex.
 * @param {import("three").Color} plain where none is near.
 */
export function byParticle(light, near, plain) {
  const out = new Float32Array(3 * near.length);
  for (let v = 0; v < near.length; v++) {
    if (near[v] === NONE) plain.toArray(out, 3 * v);
    else out.set(light.subarray(3 * near[v], 3 * near[v] + 3), 3 * v);
  }
  return out;
}
