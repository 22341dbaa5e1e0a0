/** Several panels as one: the same camera, the same display, the same scale of colours. */
import { join } from "../../viewer/colors.js";

export class Links {
  constructor() {
    this.panels = [];
    this.known = "";
    this.scale = null;
    this.framed = false; // whether everything is in sight, as nobody has moved the camera since
  }

  /** Take a panel in. */
  add(panel) {
    this.panels.push(panel);
    return panel;
  }

  /** Give the camera of one panel to the others. */
  async look(panel, view) {
    this.framed = false;
    for (const other of this.panels) {
      if (other === panel) continue;
      const viewer = await other.viewer;
      if (viewer) viewer.view = view;
    }
  }

  /** Everything in sight again; what the first panel sees, all see. */
  async reset() {
    this.framed = true;
    const viewers = (await Promise.all(this.panels.map((panel) => panel.viewer))).filter(Boolean);
    for (const viewer of viewers) viewer.reset();
    const widest = viewers.reduce((a, b) => (a.distance > b.distance ? a : b), viewers[0]);
    for (const viewer of viewers) viewer.view = widest.view; // from now on none fits itself alone
  }

  /** Have everything in sight where more or less of the views is covered than before. */
  refit() {
    if (this.framed) this.reset();
  }

  /** The range of the present colouring over all panels, measured once for what is known. */
  range() {
    const { colour, up } = this.panels[0].display;
    const known = JSON.stringify([colour, up, this.panels.map((panel) => panel.frames.known), this.panels.map((panel) => panel.frames.count > 0)]);
    if (known !== this.known) {
      this.known = known;
      this.scale = this.#measure(colour);
    }
    return this.scale;
  }

  async #measure(colour) {
    const found = await Promise.all(this.panels.map((panel) => panel.measure().catch(() => null)));
    const ranges = found.filter(Boolean);
    return ranges.length ? join(colour, ranges) : null;
  }

  /** Colour all of them again. */
  recolour() {
    this.known = "";
    return Promise.all(this.panels.map((panel) => panel.recolour()));
  }
}
