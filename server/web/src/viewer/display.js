/** What the viewer shows and how: one set of controls for one view or for several. */
import { h } from "../dom.js";
import { number } from "../format.js";
import { iconButton } from "../icons.js";
import { query, setQuery } from "../navigation.js";
import { COLOURS } from "./colors.js";
import { FOCUS } from "./focus.js";
import { LOOKS } from "./looks.js";
import { LEVELS } from "./quality.js";

const PLACE = "morph-display";
const EXTENT = 14; // half edge of the domain's safe part [grid units]
const KEPT = ["colour", "target"]; // for next time, as they are a matter of taste
const SHAPES = [
  ["surface", "Surface"],
  ["points", "Particles"],
];

/** What the surface of the first and last frames is: as in exports. */
const ENDS = [
  ["matter", "As computed"],
  ["meshes", "Snapped to meshes"],
];

/** Colours that tell nothing: those of the shapes, where these have any, and that of the look alone. */
const PLAIN_COLOURS = [
  ["own", "Of the shapes"],
  ["look", "Of the material"],
];

/** How things are shown until somebody chooses otherwise. */
export const USUAL = {
  shape: "surface",
  ends: "matter",
  look: "clay",
  colour: "own",
  target: "none",
  axis: "none",
  offset: 0,
  up: "y",
  quality: "auto",
  focus: "sharp",
};

/** What the address may say, so that who follows it sees the same. */
const ADDRESSED = {
  shape: SHAPES.map(([name]) => name),
  ends: ENDS.map(([name]) => name),
  look: Object.keys(LOOKS),
  focus: Object.keys(FOCUS),
  quality: ["auto", ...LEVELS.map(({ name }) => name)],
};

/** Controls of the display; `onChange` hears every choice. */
export class Display {
  /** @param {{onChange: (display: object) => void, open?: boolean}} options `open`: at first. */
  constructor({ onChange, open = true }) {
    this.onChange = onChange;
    this.state = { ...USUAL, ...stored(), ...addressed() };
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
    this.reading = h("output", { class: "quiet cut-reading" });
    this.drawn = h("output", { class: "small quiet drawn-reading" });
    this.toggle = iconButton("Display", "display", () => this.#open(this.element.hidden), {
      key: "T",
      "aria-controls": "display",
    });
    this.selects = {};
    this.element = h(
      "div",
      { class: "display floating", id: "display", role: "group", "aria-label": "Display" },
      this.#choice("shape", "Show as", SHAPES, "S: surface, P: particles"),
      this.#choice("look", "Look", Object.entries(LOOKS).map(([name, { label }]) => [name, label]), "Material of the surface"),
      (this.ends = this.#choice("ends", "Ends", ENDS, "The surface of the first and last frames")),
      this.#choice("colour", "Colour", [...PLAIN_COLOURS, ...colours], "What the colours show"),
      this.#choice(
        "target",
        "Target",
        [
          ["none", "Hidden"],
          ["cloud", "Cloud"],
          ["wireframe", "Wireframe"],
        ],
        "The target shape",
      ),
      this.#choice(
        "axis",
        "Cut",
        [
          ["none", "Whole"],
          ["x", "Across x"],
          ["y", "Across y"],
          ["z", "Across z"],
        ],
        "Cut away everything beyond a plane",
      ),
      (this.slider = h(
        "div",
        { class: "field cut" },
        h(
          "label",
          { class: "small", for: "display-offset" },
          h("span", { class: "visually-hidden" }, "Position of the cut"),
          this.reading,
        ),
        this.offset,
      )),
      this.#choice(
        "up",
        "Up",
        [
          ["y", "y"],
          ["z", "z"],
        ],
        "The axis that points up",
      ),
      this.#choice(
        "focus",
        "Focus",
        Object.entries(FOCUS).map(([name, { label }]) => [name, label]),
        "Depth of field: blurs what is nearer or farther than the point in focus",
      ),
      this.#choice(
        "quality",
        "Drawing",
        [["auto", "Automatic"], ...LEVELS.map(({ name, label }) => [name, label])],
        "Finer drawing takes longer",
      ),
      this.drawn,
    );
    this.#reflect();
    this.#open(open && matchMedia("(min-width: 64rem)").matches);
  }

  /** Change some of it. */
  set(change) {
    Object.assign(this.state, change, "shape" in change && { asked: true });
    const { state } = this;
    localStorage.setItem(PLACE, JSON.stringify(Object.fromEntries(KEPT.map((name) => [name, state[name]]))));
    for (const name of Object.keys(ADDRESSED)) {
      if (name in change) setQuery(name, state[name] === USUAL[name] ? null : state[name]);
    }
    this.#reflect();
    this.onChange(state);
  }

  /** Have the scene upright as a job has put it, unless somebody has chosen otherwise. */
  stand({ placement }) {
    const up = placement?.up ?? USUAL.up;
    if (!this.stood && up !== this.state.up) this.set({ up });
    this.stood = true;
  }

  /** Say how finely is drawn, see quality.js. */
  tell({ still, moving }) {
    this.drawn.textContent = still === moving ? `Drawing: ${still}` : `Drawing: ${still}; in motion: ${moving}`;
  }

  /** Offer the colours of the shapes, which have some. */
  offerOwn() {
    this.own = true;
    this.#reflect();
  }

  #choice(name, label, options, title) {
    const id = `display-${name}`;
    const select = h(
      "select",
      { id, title, value: this.state[name], on: { change: () => this.set({ [name]: select.value }) } },
      options.map(([value, text]) => h("option", { value }, text)),
    );
    this.selects[name] = select;
    return h("div", { class: `field choice-${name}` }, h("label", { class: "small", for: id }, label), select);
  }

  #open(open) {
    this.element.hidden = !open;
    this.toggle.setAttribute("aria-expanded", String(open));
  }

  #reflect() {
    for (const [name, select] of Object.entries(this.selects)) select.value = this.state[name];
    const [own, look] = this.selects.colour.options;
    const both = this.own || this.state.colour === "look";
    own.text = both ? PLAIN_COLOURS[0][1] : PLAIN_COLOURS[1][1];
    look.hidden = look.disabled = !both;
    this.ends.hidden = this.state.shape !== "surface";
    this.slider.hidden = this.state.axis === "none";
    this.drawn.hidden = this.state.quality !== "auto"; // else it is what was chosen
    this.reading.textContent = `${this.state.axis} = ${number(this.state.offset, 3)} dx`;
    this.offset.setAttribute("aria-valuetext", `${number(this.state.offset, 3)} grid units`);
  }
}

function addressed() {
  const found = Object.entries(ADDRESSED).map(([name, values]) => [name, values.find((one) => one === query(name))]);
  return Object.fromEntries(found.filter(([, value]) => value));
}

function stored() {
  try {
    const found = JSON.parse(localStorage.getItem(PLACE)) ?? {};
    const known = COLOURS[found.colour] || PLAIN_COLOURS.some(([name]) => name === found.colour);
    return known ? Object.fromEntries(KEPT.filter((name) => name in found).map((name) => [name, found[name]])) : {};
  } catch {
    return {};
  }
}
