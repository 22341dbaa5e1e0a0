/** What the viewer shows and how: one set of controls for one view or for several. */
import { h } from "../dom.js";
import { number } from "../format.js";
import { COLOURS } from "./colors.js";

const PLACE = "morph-display";
const EXTENT = 14; // half edge of the domain's safe part [grid units]

/** How things are shown until somebody chooses otherwise. */
export const USUAL = {
  colour: "height",
  shape: "points",
  target: "none",
  axis: "none",
  offset: 0,
  up: "y",
};

/** Controls of the display; `onChange` hears every choice. Those of taste are kept for next time. */
export class Display {
  /** @param {{onChange: (display: object) => void}} options */
  constructor({ onChange }) {
    this.onChange = onChange;
    this.state = { ...USUAL, ...stored() };
    const colours = Object.entries(COLOURS).map(([name, { label }]) => [name, label]);
    this.offset = h("input", {
      type: "range",
      min: -EXTENT,
      max: EXTENT,
      step: 0.1,
      value: 0,
      id: "display-offset",
      on: { input: (event) => this.set({ offset: Number(event.target.value) }) },
    });
    this.reading = h("output", { class: "small quiet cut-reading" });
    this.element = h(
      "div",
      { class: "display", role: "group", "aria-label": "Display" },
      this.#choice("colour", "Colour", [["none", "One colour"], ...colours]),
      this.#choice("shape", "Show as", [
        ["points", "Particles"],
        ["surface", "Surface"],
      ]),
      this.#choice("target", "Target", [
        ["none", "Hidden"],
        ["cloud", "Cloud"],
        ["wireframe", "Wireframe"],
      ]),
      this.#choice("axis", "Cut", [
        ["none", "Whole"],
        ["x", "Across x"],
        ["y", "Across y"],
        ["z", "Across z"],
      ]),
      (this.slider = h(
        "div",
        { class: "field cut" },
        h("label", { class: "small quiet", for: "display-offset" }, "Position of the cut"),
        h("div", { class: "row" }, this.offset, this.reading),
      )),
      this.#choice("up", "Up", [
        ["y", "y"],
        ["z", "z"],
      ]),
    );
    this.#reflect();
  }

  /** Change some of it. */
  set(change) {
    Object.assign(this.state, change);
    const { colour, target, up } = this.state;
    localStorage.setItem(PLACE, JSON.stringify({ colour, target, up }));
    this.#reflect();
    this.onChange(this.state);
  }

  #choice(name, label, options) {
    const id = `display-${name}`;
    const select = h(
      "select",
      { id, value: this.state[name], on: { change: () => this.set({ [name]: select.value }) } },
      options.map(([value, text]) => h("option", { value }, text)),
    );
    return h(
      "div",
      { class: `field choice-${name}` },
      h("label", { class: "small quiet", for: id }, label),
      select,
    );
  }

  #reflect() {
    this.slider.hidden = this.state.axis === "none";
    this.reading.textContent = `${this.state.axis} = ${number(this.state.offset, 3)} dx`;
    this.offset.setAttribute("aria-valuetext", `${number(this.state.offset, 3)} grid units`);
  }
}

/** Which axis stands upright, as was last chosen. */
export function upright() {
  return stored().up ?? USUAL.up;
}

function stored() {
  try {
    const found = JSON.parse(localStorage.getItem(PLACE)) ?? {};
    return COLOURS[found.colour] || found.colour === "none" ? found : {};
  } catch {
    return {};
  }
}
