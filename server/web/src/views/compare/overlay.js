/** One chart a metric, one curve a job. */
import { Chart } from "../../charts/chart.js";
import { FINAL } from "../../charts/groups.js";
import { fill, h } from "../../dom.js";
import { jobName } from "../../format.js";

const SHOWN = ["two_sided", "hausdorff", "f1", "coverage", "overlap_h10", "many_to_one", "det_f_min", "det_f_max"];

/** Charts that lay the curves of several jobs over each other. */
export class Overlay {
  /** @param {{onSeek: (index: number) => void, signal: AbortSignal}} options */
  constructor({ onSeek, signal }) {
    Object.assign(this, { onSeek, signal });
    this.charts = new Map();
    this.element = h("div", { class: "charts" });
  }

  /** @param {object[]} jobs @param {object[][]} rows metrics of the frames of each job. */
  set(jobs, rows) {
    const frames = [...new Set(rows.flat().map((row) => row.frame))].sort((a, b) => a - b);
    const names = SHOWN.filter((name) => rows.flat().some((row) => name in row));
    if (names.join() !== [...this.charts.keys()].join()) {
      this.replaced?.abort();
      this.replaced = new AbortController();
      const signal = AbortSignal.any([this.signal, this.replaced.signal]);
      this.charts = new Map(names.map((name) => [name, this.#chart(name, jobs, signal)]));
      fill(this.element, [...this.charts.values()].map((chart) => chart.element));
    }
    const byFrame = rows.map((one) => new Map(one.map((row) => [row.frame, row])));
    for (const [name, chart] of this.charts) {
      chart.setData(
        frames,
        byFrame.map((one) => frames.map((frame) => one.get(frame)?.[name] ?? null)),
      );
    }
  }

  /** Mark a frame in all charts. */
  setFrame(index) {
    for (const chart of this.charts.values()) chart.setFrame(index);
  }

  #chart(name, jobs, signal) {
    return new Chart({
      title: FINAL[name].label,
      unit: FINAL[name].unit,
      labels: jobs.map(jobName),
      key: "compare",
      onSeek: this.onSeek,
      signal,
    });
  }
}
