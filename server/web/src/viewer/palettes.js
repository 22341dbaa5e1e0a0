/** Palettes as tables of 256 colours: one for amounts, one for ratios about 1. */
import { rgb } from "d3-color";
import { interpolateRdBu, interpolateViridis } from "d3-scale-chromatic";

export const LEVELS = 256;

const INTERPOLATE = {
  sequential: interpolateViridis,
  diverging: (t) => interpolateRdBu(1 - t),
};

const tables = new Map();

/**
 * The colours of a palette.
 *
 * @param {"sequential" | "diverging"} name perceptually uniform; or blue, white, red.
 * @returns {Uint8ClampedArray} red, green, blue, alpha of each level, from low to high.
 */
export function palette(name) {
  if (!tables.has(name)) {
    const table = new Uint8ClampedArray(4 * LEVELS);
    for (let i = 0; i < LEVELS; i++) {
      const { r, g, b } = rgb(INTERPOLATE[name](i / (LEVELS - 1)));
      table.set([r, g, b, 255], 4 * i);
    }
    tables.set(name, table);
  }
  return tables.get(name);
}
