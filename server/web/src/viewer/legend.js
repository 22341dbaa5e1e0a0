/** The scale of colours with its numbers and its unit. */
import { fill, h } from "../dom.js";
import { number } from "../format.js";
import { LEVELS, palette } from "./palettes.js";
import { COLOURS } from "./colors.js";

const STEPS = 4;

/** A legend; `show` changes what it says. */
export class Legend {
  constructor() {
    this.canvas = h("canvas", { width: LEVELS, height: 1, "aria-hidden": "true" });
    this.label = h("p", { class: "legend-label" });
    this.ticks = h("p", { class: "legend-ticks" });
    this.element = h("div", { class: "legend", hidden: true }, this.label, this.canvas, this.ticks);
  }

  /**
   * @param {string | null} name of the colouring; null hides the legend.
   * @param {{low: number, high: number, palette: string}} [scale] of ratios, as log2.
   */
  show(name, scale) {
    this.element.hidden = !name || !scale;
    if (this.element.hidden) return;
    const { label, unit, ratio } = COLOURS[name];
    fill(this.label, label, h("span", { class: "quiet" }, ` ${unit}`));
    const colours = new ImageData(palette(scale.palette).slice(), LEVELS, 1);
    this.canvas.getContext("2d").putImageData(colours, 0, 0);
    const marks = Array.from({ length: STEPS + 1 }, (_, i) => {
      const value = scale.low + (i / STEPS) * (scale.high - scale.low);
      return h("span", null, ratio ? number(2 ** value, 2) : mark(value, scale.high - scale.low));
    });
    fill(this.ticks, marks);
  }
}

/** A number as exact as a step of the scale asks for. */
function mark(value, width) {
  const decimals = Math.max(0, 1 - Math.floor(Math.log10(width)));
  return String(Number(value.toFixed(Math.min(decimals, 6)))).replace("-", "\u2212");
}
