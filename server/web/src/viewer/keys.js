/** Keys as in Blender, and the dialog that lists them. */
import { h } from "../dom.js";

const TYPED = "input, select, textarea, dialog *";
const PRESSED = "button, a, summary";

/**
 * Bind keys, in an element or wherever one is, for as long as the signal allows. They rest where text is typed or something is chosen,
 * and the space bar rests on what it would press.
 *
 * @param {Record<string, () => void>} bindings by name: a letter, a digit with or without "Shift+"
 *   (of the row or of the number pad alike), or what the browser calls the key.
 * @param {AbortSignal} signal
 */
export function bindKeys(bindings, { signal, element = document }) {
  const listen = (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest?.(TYPED) || document.querySelector("dialog[open]")) return;
    const name = nameOf(event);
    if ((name === " " || name === "Enter") && event.target.closest?.(PRESSED)) return;
    if (!bindings[name]) return;
    event.preventDefault();
    bindings[name]();
  };
  element.addEventListener("keydown", listen, { signal });
}

/**
 * Bindings that move a camera.
 *
 * @param {(move: object) => void} steer as the viewer's method.
 */
export function cameraKeys(steer) {
  const ways = { 4: [1, 0], 6: [-1, 0], 8: [0, 1], 2: [0, -1] };
  const bindings = {
    "+": () => steer({ zoom: 1 }),
    "=": () => steer({ zoom: 1 }),
    "-": () => steer({ zoom: -1 }),
  };
  for (const side of ["1", "3", "7", "9"]) bindings[side] = () => steer({ side });
  for (const [key, way] of Object.entries(ways)) {
    bindings[key] = () => steer({ turn: way });
    bindings[`Shift+${key}`] = () => steer({ pan: way });
  }
  return bindings;
}

function nameOf({ code, key, shiftKey }) {
  const digit = /^(?:Digit|Numpad)(\d)$/.exec(code)?.[1];
  const base = digit ?? (key.length === 1 ? key.toLowerCase() : key);
  return shiftKey && base.length + Boolean(digit) > 1 ? `Shift+${base}` : base;
}

const LIST = [
  ["Space", "play, pause"],
  ["← →", "previous frame, next frame"],
  ["Shift ← →", "first frame, last frame"],
  ["Home 0", "fit to view"],
  ["1 3 7", "view from the front, the right, the top"],
  ["9", "view from the opposite side"],
  ["4 6 8 2", "turn left, right, up, down; with Shift move"],
  ["+ −", "zoom in, zoom out"],
  ["S P", "surface, particles"],
  ["T", "display: what is shown, and how"],
  ["N", "details: numbers, settings, files"],
  ["F", "full screen"],
  ["?", "this list"],
];

/** Show the list of keys. */
export function showKeys() {
  const dialog = h(
    "dialog",
    { "aria-labelledby": "keys-title", class: "keys" },
    h(
      "form",
      { method: "dialog", class: "stack" },
      h("h2", { id: "keys-title" }, "Keys"),
      h(
        "dl",
        null,
        LIST.map(([keys, does]) =>
          h("div", null, h("dt", null, keys.split(" ").map((key) => h("kbd", null, key))), h("dd", null, does)),
        ),
      ),
      h("p", { class: "quiet small" }, "Drag to turn, right button or two fingers to move, wheel to zoom."),
      h("div", { class: "actions" }, h("button", { autofocus: true }, "Close")),
    ),
  );
  dialog.addEventListener("close", () => dialog.remove());
  (document.fullscreenElement ?? document.body).append(dialog);
  dialog.showModal();
}
