/** How a shape stands beside the other one: turned, scaled and moved, by numbers or by handles in its picture. */

import { fill, h } from "../../dom.js";

const AXES = ["x", "y", "z"];
const HANDLES = [
  ["none", "No handles"],
  ["turn", "Rotate"],
  ["move", "Move"],
  ["scale", "Scale"],
];

/** The pose of nothing that was asked for. */
export const AS_IT_IS = { up: "auto", rotate: [0, 0, 0], scale: 1, move: [0, 0, 0] };

const QUARTER = 90; // [degrees]
const TURNS = ["up", "rotate"];

/**
 * The poses among settings by dotted path, as far as the particles of one end depend on them, and as the
 * service takes them for previews; "" for none.
 *
 * @param {object} overrides
 * @param {string} own the end, which is turned, scaled and moved
 * @param {string} [other] the other one, whose turns the fit looks at
 */
export function posesOf(overrides, own, other) {
  const poses = {};
  const wanted = { [own]: Object.keys(AS_IT_IS), ...(other && { [other]: TURNS }) };
  for (const [role, names] of Object.entries(wanted)) {
    for (const name of names) {
      const value = overrides[`placement.${role}.${name}`];
      if (value !== undefined) (poses[role] ??= {})[name] = value;
    }
  }
  return Object.keys(poses).length ? JSON.stringify(poses) : "";
}

/** Numbers and handles for one end of a morph. */
export class Pose {
  /**
   * @param {string} role "source" or "target"
   * @param {import("./preview.js").Preview} preview where the handles are
   * @param {(changes: Record<string, any>) => void} changed hears settings of the pose, undefined for the usual ones
   */
  constructor(role, preview, changed) {
    Object.assign(this, { role, preview, changed, pose: AS_IT_IS, mode: "none" });
    this.said = h("span", { class: "quiet small" });
    this.trouble = h("p", { class: "fault", role: "alert" });
    this.up = this.upField();
    this.unknown = h("span", { class: "small", hidden: true }, "The file does not say which way is up.");
    this.upright = h(
      "div",
      { class: "row upright" },
      this.unknown,
      h(
        "button",
        { type: "button", class: "compact", title: "Rotate it by 90° about x", on: { click: () => this.tip() } },
        "Tip it over",
      ),
    );
    this.turns = this.vector("rotate", "Rotate about", "°", 15);
    this.moves = this.vector("move", "Move along", "grid units", 1);
    this.factor = this.number("scale", "Size", 0.1);
    this.reset = h("button", { type: "button", class: "compact", on: { click: () => this.forget() } }, "Reset");
    this.buttons = HANDLES.map(([mode, text]) =>
      h("button", { type: "button", class: "compact", data: { mode }, on: { click: () => this.take(mode) } }, text),
    );
    this.element = h(
      "details",
      { class: "pose" },
      h("summary", null, h("span", null, "Rotate and move"), " ", this.said),
      h(
        "div",
        { class: "stack" },
        h("div", { class: "row", role: "group", "aria-label": `Handles in the view of the ${role}` }, this.buttons),
        this.up.element,
        this.turns.element,
        this.moves.element,
        h("div", { class: "field" }, h("label", { for: `${role}-scale` }, "Size", h("span", { class: "quiet unit" }, " [times]")), this.factor),
        this.trouble,
        h("div", { class: "row" }, this.reset),
      ),
    );
    this.element.addEventListener("toggle", () => this.element.open || this.take("none"));
    preview.listen(() => this.handles());
    this.take("none");
    this.show(AS_IT_IS, "");
  }

  /**
   * Show a pose.
   *
   * @param {object} pose
   * @param {string} guess what `auto` makes of the upward axis, in words
   * @param {boolean} [unknown] whether that is nothing
   */
  show(pose, guess, unknown = false) {
    this.pose = pose;
    this.unknown.hidden = !unknown || pose.up !== "auto" || pose.rotate.some(Boolean);
    fill(this.trouble);
    this.up.select.value = pose.up;
    fill(this.up.auto, guess ? `From the file (${guess})` : "From the file");
    for (const [name, inputs] of [["rotate", this.turns.inputs], ["move", this.moves.inputs]]) {
      inputs.forEach((input, i) => input === document.activeElement || (input.value = String(pose[name][i])));
    }
    if (this.factor !== document.activeElement) this.factor.value = String(pose.scale);
    const done = [
      pose.up !== "auto" && `${pose.up} up`,
      pose.rotate.some(Boolean) && "rotated",
      pose.scale !== 1 && "scaled",
      pose.move.some(Boolean) && "moved",
    ].filter(Boolean);
    fill(this.said, done.join(", "));
    this.reset.disabled = done.length === 0;
  }

  /** Show handles of a kind, or none. */
  take(mode) {
    this.mode = mode;
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.mode === mode));
    this.handles();
  }

  async handles() {
    const { preview, mode } = this;
    this.gizmo?.dispose();
    this.gizmo = null;
    if (mode === "none" || !preview.viewer || preview.scene.classList.contains("empty")) return;
    const { Gizmo } = await import("../../viewer/gizmo.js");
    if (mode !== this.mode || this.gizmo || preview.signal.aborted) return;
    this.gizmo = new Gizmo(preview.viewer, mode, (change) => this.drawn(change));
  }

  /** The handles have been let go. */
  drawn({ turned, scale, move }) {
    const { rotate, scale: before, move: from } = this.pose;
    this.tell({
      rotate: turned(rotate).map((one) => rounded(one, 1)),
      scale: rounded(before * scale, 3),
      move: from.map((one, i) => rounded(one + move[i], 2)),
    });
  }

  /** Turn it from lying to standing, to its head, and so on. */
  tip() {
    const [x, ...others] = this.pose.rotate;
    const turned = x - QUARTER <= -180 ? x - QUARTER + 360 : x - QUARTER;
    this.tell({ rotate: [turned, ...others] });
  }

  forget() {
    this.tell(AS_IT_IS);
    this.element.querySelector("summary").focus();
  }

  tell(changes) {
    const settings = Object.entries(changes).map(([name, value]) => {
      const usual = JSON.stringify(value) === JSON.stringify(AS_IT_IS[name]);
      return [`placement.${this.role}.${name}`, usual ? undefined : value];
    });
    this.changed(Object.fromEntries(settings));
  }

  upField() {
    const id = `${this.role}-up`;
    const auto = h("option", { value: "auto" }, "From the file");
    const change = () => this.tell({ up: select.value });
    const select = h("select", { id, on: { change } }, auto, h("option", { value: "y" }, "y"), h("option", { value: "z" }, "z"));
    return { select, auto, element: h("div", { class: "field" }, h("label", { for: id }, "Upward axis"), select) };
  }

  vector(name, title, unit, step) {
    const inputs = AXES.map((axis) => this.number(name, `${title} ${axis}`, step, axis));
    const element = h(
      "fieldset",
      { class: "field" },
      h("legend", null, title, h("span", { class: "quiet unit" }, ` [${unit}]`)),
      h("div", { class: "vector" }, inputs.map((input, i) => h("label", null, h("span", { class: "quiet" }, AXES[i]), input))),
    );
    return { inputs, element };
  }

  number(name, title, step, axis = "") {
    return h("input", {
      type: "number",
      id: `${this.role}-${name}${axis && `-${axis}`}`,
      step: "any",
      inputmode: "decimal",
      autocomplete: "off",
      "aria-label": axis ? `${title}, ${this.role}` : null,
      "data-step": step,
      on: { change: () => this.read(name), keydown: stepped },
    });
  }

  read(name) {
    const inputs = { rotate: this.turns.inputs, move: this.moves.inputs, scale: [this.factor] }[name];
    const values = inputs.map((input) => (input.value.trim() === "" ? NaN : Number(input.value)));
    const fine = values.every(Number.isFinite) && (name !== "scale" || values[0] > 0);
    fill(this.trouble, fine ? "" : name === "scale" ? "Enter a size above 0." : "Enter a number for each axis.");
    if (fine) this.tell({ [name]: name === "scale" ? values[0] : values });
  }
}

/** The arrow keys change a number by useful steps, whatever number it is. */
function stepped(event) {
  const sign = { ArrowUp: 1, ArrowDown: -1 }[event.key];
  if (!sign) return;
  event.preventDefault();
  const input = event.target;
  input.value = String(rounded((Number(input.value) || 0) + sign * Number(input.dataset.step), 3));
  input.dispatchEvent(new Event("change", { bubbles: true }));
}

function rounded(value, digits) {
  return Number(value.toFixed(digits)) + 0; // of which no zero is negative
}
