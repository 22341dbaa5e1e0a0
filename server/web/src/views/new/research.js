/** What a researcher chooses: folded away until somebody wants it, and remembered open. */
import { h } from "../../dom.js";

const PLACE = "morph-research";

/**
 * @param {HTMLElement[]} content
 * @returns {HTMLDetailsElement}
 */
export function research(...content) {
  const keep = () => localStorage.setItem(PLACE, element.open ? "" : "open"); // it opens after the click
  const element = h(
    "details",
    { class: "part research" },
    h(
      "summary",
      { on: { click: keep } },
      h("h2", null, "Research"),
      h("span", { class: "quiet small" }, "All methods, presets and settings"),
    ),
    h("div", { class: "stack" }, ...content),
  );
  element.open = localStorage.getItem(PLACE) === "open";
  return element;
}
