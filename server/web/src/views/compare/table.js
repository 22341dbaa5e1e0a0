/** Final metrics of several jobs, with their differences to the first. */
import { h } from "../../dom.js";
import { jobName, number } from "../../format.js";
import { FINAL } from "../../charts/groups.js";

const EQUAL = 1e-9;

/** @returns {HTMLElement} the table. */
export function table(jobs) {
  const metrics = jobs.map((job) => job.outcome?.metrics ?? job.progress.metrics);
  const names = Object.keys(FINAL).filter((name) => metrics.some((one) => name in one));
  return h(
    "div",
    { class: "table-scroll differences", tabindex: 0, role: "region", "aria-label": "Metrics of the last frames" },
    h(
      "table",
      null,
      h("caption", { class: "visually-hidden" }, "Metrics of the last frames, with differences from the first job"),
      h(
        "thead",
        null,
        h(
          "tr",
          null,
          h("th", { scope: "col" }, "Last frame"),
          jobs.map((job, i) =>
            h("th", { scope: "col", class: "number" }, h("i", { class: `swatch series-${i + 1}` }), jobName(job)),
          ),
        ),
      ),
      h(
        "tbody",
        null,
        names.map((name) =>
          h(
            "tr",
            null,
            h("th", { scope: "row" }, FINAL[name].label, h("span", { class: "quiet" }, ` ${FINAL[name].unit}`)),
            metrics.map((one, i) => cell(name, one, metrics, i)),
          ),
        ),
      ),
    ),
  );
}

function cell(name, one, metrics, i) {
  const value = one[name];
  const first = metrics[0][name];
  const best = metrics.length > 1 && isBest(name, value, metrics);
  const shown = [h("span", { class: best ? "best" : null }, number(value, 3), best && h("span", { class: "visually-hidden" }, " (best)"))];
  if (i > 0 && Number.isFinite(value) && Number.isFinite(first)) {
    const way = verdict(name, value, first);
    const sign = value > first ? "+" : value < first ? "\u2212" : "\u00b1";
    shown.push(
      h("span", { class: `difference small ${way}` }, `${sign}${number(Math.abs(value - first), 2)}`, way !== "same" && ` ${way}`),
    );
  }
  return h("td", { class: "number" }, shown);
}

/** How much is to be wished: less is better. */
function badness(name, value) {
  const { better } = FINAL[name];
  if (better === "one") return Math.abs(Math.log(Math.max(value, 1e-12)));
  return better === "lower" ? value : -value;
}

function verdict(name, value, first) {
  const difference = badness(name, value) - badness(name, first);
  if (Math.abs(difference) < EQUAL) return "same";
  return difference < 0 ? "better" : "worse";
}

function isBest(name, value, metrics) {
  if (!Number.isFinite(value)) return false;
  const all = metrics.map((one) => badness(name, one[name] ?? NaN)).filter(Number.isFinite);
  const mine = badness(name, value);
  return mine <= Math.min(...all) + EQUAL && all.some((other) => other > mine + EQUAL);
}
