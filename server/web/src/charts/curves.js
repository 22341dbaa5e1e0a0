/** The metrics of one job as small charts and as a table. */
import { fill, h } from "../dom.js";
import { number } from "../format.js";
import { Chart } from "./chart.js";
import { GROUPS } from "./groups.js";

const KEY = "curves";

/** Charts of those metrics that the job has. */
export class Curves {
  /** @param {{onSeek: (index: number) => void, signal: AbortSignal}} options */
  constructor({ onSeek, signal }) {
    Object.assign(this, { onSeek, signal });
    this.charts = [];
    this.rows = [];
    this.frame = 0;
    this.grid = h("div", { class: "charts" });
    this.table = h("div", { class: "table-scroll", tabindex: 0, role: "region", "aria-label": "Metrics by frame" });
    this.details = h(
      "details",
      { on: { toggle: () => this.#fillTable() } },
      h("summary", null, "All numbers as a table"),
      this.table,
    );
    this.empty = h("p", { class: "quiet" }, "Curves appear with the first frame.");
    this.element = h("div", { class: "stack" }, this.empty, this.grid, this.details);
    this.details.hidden = true;
  }

  /** @param {object[]} rows metrics of frames, `frame` among them, in the order of frames. */
  setRows(rows) {
    this.rows = rows;
    this.empty.hidden = rows.length > 0;
    this.details.hidden = rows.length === 0;
    const groups = GROUPS.map((group) => ({
      ...group,
      present: Object.keys(group.names).filter((name) => rows.some((row) => name in row)),
    })).filter((group) => group.present.length);
    const shape = JSON.stringify(groups.map((group) => group.present));
    if (shape !== this.shape) {
      this.shape = shape;
      this.replaced?.abort();
      this.replaced = new AbortController();
      const signal = AbortSignal.any([this.signal, this.replaced.signal]);
      this.charts = groups.map(({ title, unit, log, names, present }) => ({
        present,
        chart: new Chart({
          title,
          unit,
          log,
          labels: present.map((name) => names[name]),
          key: KEY,
          onSeek: this.onSeek,
          signal,
        }),
      }));
      fill(this.grid, this.charts.map(({ chart }) => chart.element));
    }
    const frames = rows.map((row) => row.frame);
    for (const { chart, present } of this.charts) {
      chart.setData(frames, present.map((name) => rows.map((row) => row[name] ?? null)));
      chart.setFrame(this.frame);
    }
    this.#fillTable();
  }

  /** Mark a frame in all charts. */
  setFrame(index) {
    this.frame = index;
    for (const { chart } of this.charts) chart.setFrame(index);
  }

  #fillTable() {
    if (!this.details.open) return;
    const names = [...new Set(this.rows.flatMap((row) => Object.keys(row)))].filter((name) => name !== "frame");
    fill(
      this.table,
      h(
        "table",
        null,
        h("caption", { class: "visually-hidden" }, "Metrics of every frame"),
        h(
          "thead",
          null,
          h("tr", null, ["frame", ...names].map((name) => h("th", { scope: "col" }, name))),
        ),
        h(
          "tbody",
          null,
          this.rows.map((row) =>
            h(
              "tr",
              null,
              h("th", { scope: "row" }, row.frame + 1),
              names.map((name) => h("td", { class: "number" }, number(row[name], 4))),
            ),
          ),
        ),
      ),
    );
  }
}
