/** Small drawings for buttons, each a path in a square of 16. */
import { h, svg } from "./dom.js";

const FILLED = new Set(["play", "pause"]);
const PATHS = {
  play: "M4 2.5v11l9-5.5z",
  pause: "M4 2.5h3v11H4zM9 2.5h3v11H9z",
  back: "M10.5 2.5 5 8l5.5 5.5",
  forward: "M5.5 2.5 11 8l-5.5 5.5",
  frame: "M2 5V2h3M11 2h3v3M14 11v3h-3M5 14H2v-3M8 6a2 2 0 1 0 0 4 2 2 0 0 0 0-4z",
  full: "M6 10l-4 4M2 10v4h4M10 6l4-4M10 2h4v4",
  display: "M2 4h7M13 4h1M2 12h1M7 12h7M11 2.5v3M5 10.5v3",
  details: "M2 3h12v10H2zM10 3v10",
  close: "M3.5 3.5l9 9M12.5 3.5l-9 9",
};

/** The drawing with a name. */
export function icon(name) {
  const filled = FILLED.has(name);
  return svg(
    "svg",
    { viewBox: "0 0 16 16", width: 16, height: 16, "aria-hidden": "true" },
    svg("path", {
      d: PATHS[name],
      fill: filled ? "currentColor" : "none",
      stroke: filled ? "none" : "currentColor",
      "stroke-width": 1.75,
      "stroke-linecap": "round",
      "stroke-linejoin": "round",
    }),
  );
}

/**
 * A button that shows a drawing; its name is read aloud, and shown with its key where the pointer rests.
 *
 * @param {string} label
 * @param {string} name of the drawing.
 * @param {() => void} act
 * @param {object} [more] `key` that does the same, and further attributes.
 */
export function iconButton(label, name, act, { key, ...attributes } = {}) {
  const title = key ? `${label} (${key})` : label;
  return h(
    "button",
    { type: "button", class: "icon", "aria-label": label, title, on: { click: act }, ...attributes },
    icon(name),
  );
}
