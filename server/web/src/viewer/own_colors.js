/** The colours of a morph's shapes, which its particles carry from each shape to the next. */
const LIGHT = Float32Array.from({ length: 256 }, (_, level) => {
  const shade = level / 255;
  return shade <= 0.04045 ? shade / 12.92 : ((shade + 0.055) / 1.055) ** 2.4;
});
const STEPS = 4096;
const SHADES = Uint8Array.from({ length: STEPS + 1 }, (_, step) => {
  const light = step / STEPS;
  return Math.round(255 * (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055));
});

/** Colours of the particles in each shape, and what lies between. */
export class OwnColors {
  /**
   * @param {Uint8Array} bytes red, green and blue in sRGB of each particle, shape after shape.
   * @param {number[]} reached number of frames after which each shape is reached, from 0.
   */
  constructor(bytes, reached) {
    this.reached = reached;
    const size = bytes.length / reached.length;
    this.shapes = reached.map((_, index) => bytes.subarray(index * size, (index + 1) * size));
    this.light = new Float32Array(size);
  }

  /**
   * Colours after so many frames, of which a part may be over; mixed in linear light, slowly near a shape.
   *
   * @param {number} frames 0 for the source, and 1 for the first frame.
   * @returns {Float32Array} linear, three for each particle, in an array that the next call reuses.
   */
  after(frames) {
    const { reached, shapes, light } = this;
    const last = shapes.length - 1;
    const ahead = reached.findIndex((at) => at >= frames);
    const next = ahead < 0 ? last : ahead;
    const before = Math.max(next - 1, 0);
    const share = Math.min(Math.max((frames - reached[before]) / (reached[next] - reached[before] || 1), 0), 1);
    return lightOf(shapes[before], shapes[next], share * share * (3 - 2 * share), light);
  }
}

/**
 * What lies between two colourings in linear light.
 *
 * @param {Uint8Array} from bytes of sRGB.
 * @param {Uint8Array} to likewise.
 * @param {number} share of the second, 0..1.
 * @returns {Float32Array} linear colours.
 */
export function lightOf(from, to, share, out = new Float32Array(from.length)) {
  for (let i = 0; i < out.length; i++) {
    const begin = LIGHT[from[i]];
    out[i] = begin + share * (LIGHT[to[i]] - begin);
  }
  return out;
}

/** Linear colours as bytes of sRGB. */
export function shades(light) {
  return Uint8Array.from(light, (value) => SHADES[Math.round(STEPS * value)]);
}
