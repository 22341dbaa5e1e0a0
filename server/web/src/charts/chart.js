/** One small chart over frames, counted from 1 as the timeline does, and with its cursor. */
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";

import { h } from "../dom.js";
import { number } from "../format.js";

const HEIGHT = 150;
const FONT = "11px system-ui, sans-serif";

/** A chart; all charts with the same `key` share a cursor. */
export class Chart {
  /**
   * @param {object} options
   * @param {string} options.title
   * @param {string} options.unit
   * @param {string[]} options.labels of the series; their colours are --series-1 and on.
   * @param {boolean} [options.log]
   * @param {string} options.key
   * @param {(index: number) => void} options.onSeek hears the index of the frame that was clicked.
   * @param {AbortSignal} options.signal
   */
  constructor({ title, unit, labels, log = false, key, onSeek, signal }) {
    Object.assign(this, { title, labels, log, key, onSeek });
    this.readings = labels.map(() => h("span", { class: "value" }, "–"));
    this.frame = 0;
    this.data = [[], ...labels.map(() => [])];
    this.plot = h("div", { class: "plot", role: "img" });
    this.element = h(
      "figure",
      { class: "chart" },
      h("figcaption", null, h("h3", null, title), h("span", { class: "quiet small" }, unit)),
      h(
        "ul",
        { class: "series small" },
        labels.map((label, i) =>
          h("li", null, h("i", { class: `swatch series-${i + 1}` }), label, " ", this.readings[i]),
        ),
      ),
      this.plot,
    );
    this.marker = h("div", { class: "frame-marker" });
    const sizes = new ResizeObserver(() => this.#draw());
    sizes.observe(this.plot);
    document.addEventListener("themechange", () => this.#draw(true), { signal });
    const end = () => (sizes.disconnect(), this.chart?.destroy());
    signal.addEventListener("abort", end, { once: true });
  }

  /**
   * @param {number[]} frames their indices.
   * @param {(number | null)[][]} values of each series; null where there is none.
   */
  setData(frames, values) {
    const columns = this.log ? values.map((column) => column.map(positive)) : values;
    this.data = [frames.map((index) => index + 1), ...columns];
    this.chart?.setData(this.data);
    this.#draw();
    this.setFrame(this.frame);
  }

  /** Mark a frame and say the values there. */
  setFrame(index) {
    this.frame = index;
    this.#read(this.data[0].indexOf(index + 1));
    const summary = this.labels.map((label, i) => `${label} ${this.readings[i].textContent}`);
    this.plot.setAttribute("aria-label", `${this.title} over frames. Here: ${summary.join(", ")}.`);
    this.#mark();
  }

  #mark() {
    if (!this.chart || !this.data[0].length) return;
    const x = this.chart.valToPos(this.frame + 1, "x");
    this.marker.hidden = !Number.isFinite(x);
    const within = Math.min(Math.round(x), this.chart.over.clientWidth - 1);
    this.marker.style.transform = `translateX(${within}px)`;
  }

  #read(row) {
    this.readings.forEach((reading, i) => {
      reading.textContent = number(this.data[i + 1][row] ?? NaN, 3);
    });
  }

  #draw(again = false) {
    const width = this.plot.clientWidth;
    if (!width || !this.data[0].length) return;
    if (this.chart && !again) {
      if (this.chart.width !== width) this.chart.setSize({ width, height: HEIGHT });
      return this.#place();
    }
    this.chart?.destroy();
    const style = getComputedStyle(this.plot);
    const colour = (name) => style.getPropertyValue(name).trim();
    const axis = {
      stroke: colour("--quiet"),
      font: FONT,
      grid: { stroke: colour("--grid"), width: 1 },
      ticks: { show: false },
    };
    this.chart = new uPlot(
      {
        width,
        height: HEIGHT,
        legend: { show: false },
        cursor: {
          sync: { key: this.key },
          drag: { x: false, y: false },
          y: false,
          points: { size: 6 },
        },
        scales: {
          x: { time: false },
          y: this.log ? { distr: 3 } : { range: (_, low, high) => room(low, high) },
        },
        axes: [
          { ...axis, size: 24, gap: 4, incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000] },
          {
            ...axis,
            ...(this.log && { filter: powers, grid: { ...axis.grid, filter: powers } }),
            size: 44,
            gap: 4,
            values: (_, ticks) => ticks.map((tick) => (tick === null ? "" : short(tick))),
          },
        ],
        series: [
          { value: (_, x) => x },
          ...this.labels.map((label, i) => ({
            label,
            stroke: colour(`--series-${i + 1}`),
            width: 1.75,
            points: { show: () => this.data[0].length === 1 },
          })),
        ],
        // scales change after data do, and before they are drawn
        hooks: { draw: [() => this.#mark()], setCursor: [(chart) => this.#hover(chart.cursor.idx)] },
      },
      this.data,
      this.plot,
    );
    this.chart.over.append(this.marker);
    this.chart.over.addEventListener("click", () => {
      const row = this.chart.cursor.idx;
      if (row !== null && row !== undefined) this.onSeek(this.data[0][row] - 1);
    });
    this.#place();
  }

  #place() {
    this.setFrame(this.frame);
  }

  #hover(row) {
    this.#read(row ?? this.data[0].indexOf(this.frame + 1));
  }
}

/** A little room above and below; a flat line lies at the bottom or in the middle. */
function room(low, high) {
  if (low === high) return low === 0 ? [0, 0.01] : [low - Math.abs(low) / 10, low + Math.abs(low) / 10];
  const spare = (high - low) / 12;
  return [low >= 0 && low < high / 2 ? 0 : low - spare, high + spare];
}

/** Of the lines of a logarithmic scale, those at powers of ten. */
function powers(_, ticks) {
  return ticks.map((tick) => (Number.isInteger(Math.log10(tick)) ? tick : null));
}

function positive(value) {
  return value > 0 ? value : null;
}

function short(tick) {
  const size = Math.abs(tick);
  if (tick !== 0 && (size >= 1e4 || size < 1e-3)) return Number(tick.toPrecision(2)).toExponential();
  return String(Number(tick.toPrecision(3)));
}
