/** The landmarks of a job as a list: which point is to end where, and how far its matter is from there. */
import { fill, h } from "../../dom.js";
import { number } from "../../format.js";
import { distance } from "../../viewer/landmarks.js";
import { markColour } from "../../viewer/mark_colours.js";

/** @returns {{element: HTMLElement, show: (positions: Float32Array, particles: number[], index: number) => void}} */
export function landmarks(all) {
  const ways = all.map(() => h("span", { class: "quiet" }));
  const rows = all.map(({ name, index }, i) => {
    const dot = h("span", { class: "mark" }, index + 1);
    dot.style.background = markColour(index);
    return h("li", { class: "row" }, dot, h("span", null, name), ways[i]);
  });
  const element = h(
    "section",
    { class: "panel stack", "aria-labelledby": "landmarks" },
    h("h2", { id: "landmarks" }, "Landmarks"),
    h("p", { class: "quiet small" }, "Dots in the view follow the matter that starts at each."),
    h("ol", { class: "plain stack" }, rows),
  );
  const show = (positions, particles, index) =>
    all.forEach(({ target }, i) => {
      const away = distance(positions, particles[i], target);
      fill(ways[i], `${number(away, 2)} dx from its target point ${index < 0 ? "at first" : `in frame ${index + 1}`}`);
    });
  return { element, show };
}
