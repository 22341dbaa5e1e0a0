/** The 3D view takes the window; what controls it floats over it, and the rest is in a drawer. */
import { h } from "../dom.js";
import { iconButton } from "../icons.js";
import { watchCovered } from "./covered.js";
import { Drawer } from "./drawer.js";
import { bindKeys, cameraKeys, showKeys } from "./keys.js";
import "./viewer.css";
import "./stage.css";

/**
 * @param {object} parts
 * @param {HTMLElement} parts.headline what is shown, in words.
 * @param {HTMLElement} parts.views of one panel or of several.
 * @param {import("./panel.js").Panel} parts.panel whose camera the keys move.
 * @param {() => void} parts.frameAll brings everything in sight.
 * @param {import("./display.js").Display} parts.display
 * @param {import("./timeline.js").Timeline} parts.timeline
 * @param {object[]} parts.sheets of the drawer, see drawer.js.
 * @param {AbortSignal} parts.signal
 * @returns {HTMLElement}
 */
export function stage({ headline, views, panel, frameAll, display, timeline, sheets, signal }) {
  const drawer = new Drawer(sheets);
  const fullScreen = () =>
    document.fullscreenElement ? document.exitFullscreen() : element.requestFullscreen().catch(() => {});
  const tools = h(
    "div",
    { class: "tools floating", role: "toolbar", "aria-label": "View" },
    iconButton("Fit to view", "frame", frameAll, { key: "Home" }),
    document.fullscreenEnabled && iconButton("Full screen", "full", fullScreen, { key: "F" }),
    h(
      "button",
      { type: "button", class: "icon", "aria-label": "Keys", title: "Keys (?)", on: { click: showKeys } },
      "?",
    ),
    display.toggle,
    drawer.toggle,
  );
  const element = h(
    "div",
    { class: "stage-window" },
    h(
      "section",
      { class: "looking", "aria-label": "Viewer" },
      h("div", { class: "stage-top" }, headline, tools),
      views,
      timeline.element,
      display.element,
    ),
    drawer.element,
  );
  if (views === panel.element) watchCovered(panel, [[headline, tools], [timeline.element], [display.element]], signal);
  bindKeys(
    {
      ...cameraKeys(async (move) => (await panel.viewer)?.steer(move)),
      " ": () => timeline.toggle.click(),
      ArrowLeft: () => timeline.step(-1),
      ArrowRight: () => timeline.step(1),
      "Shift+ArrowLeft": () => timeline.step(-Infinity),
      "Shift+ArrowRight": () => timeline.step(Infinity),
      Home: frameAll,
      0: frameAll,
      s: () => display.set({ shape: "surface" }),
      p: () => display.set({ shape: "points" }),
      t: () => display.toggle.click(),
      n: () => drawer.toggle.click(),
      f: fullScreen,
      "?": showKeys,
    },
    { signal },
  );
  return element;
}
