/** Landmarks: points of the source and the points of the target where they end, picked in the pictures. */

import { fill, h } from "../../dom.js";
import { markColour } from "../../viewer/mark_colours.js";

const MOST = 64; // that the service takes
const DIGITS = 6; // of a coordinate that is picked
const ENDS = ["source", "target"];

/** The list of landmarks, and how they are picked: a click in one picture, and one in the other. */
export class Landmarks {
  /**
   * @param {import("./chooser.js").Chooser} source
   * @param {import("./chooser.js").Chooser} target
   * @param {(landmarks: object[] | undefined) => void} changed hears all of them, undefined for none
   */
  constructor(source, target, changed) {
    Object.assign(this, { previews: { source: source.preview, target: target.preview }, changed });
    this.all = [];
    this.begun = {}; // the points of a pair that is not complete
    this.picking = false;
    const button = (text, click) => h("button", { type: "button", class: "compact", on: { click } }, text);
    this.toggle = button("Pick in the views", () => this.pick(!this.picking));
    this.back = button("Undo", () => this.undo());
    this.typed = button("Add by coordinates", () => this.add({ source: [0, 0, 0], target: [0, 0, 0] }));
    this.said = h("p", { class: "small", role: "status" });
    this.list = h("ol", { "aria-label": "Landmarks" });
    this.element = h(
      "section",
      { class: "stack part landmarks", "aria-label": "Landmarks" },
      h("h2", null, "Landmarks"),
      h("p", { class: "quiet" }, "Points of the source that should end at points of the target, such as a nose at a nose. Optional."),
      h("div", { class: "row" }, this.toggle, this.back, this.typed),
      this.said,
      this.list,
    );
    for (const end of ENDS) this.previews[end].listen(() => this.mark(end));
    this.pick(false);
  }

  /** Show landmarks, as far as there can be any. */
  show(all, possible) {
    this.element.hidden = !possible;
    if (!possible && this.picking) this.pick(false);
    const focused = this.list.contains(document.activeElement) ? document.activeElement.id : "";
    this.all = all;
    fill(this.list, all.map((landmark, index) => this.row(landmark, index)));
    if (focused) (document.getElementById(focused) ?? this.list.querySelector("li:last-child button") ?? this.typed).focus();
    this.tell();
  }

  /** Begin or end picking. */
  pick(picking) {
    this.picking = picking;
    this.begun = {};
    this.toggle.setAttribute("aria-pressed", String(picking));
    for (const end of ENDS) this.previews[end].pick(picking ? (at) => this.take(end, at) : null);
    this.tell();
  }

  take(end, at) {
    if (this.all.length >= MOST) return;
    this.begun[end] = at.map((one) => Number(one.toPrecision(DIGITS)));
    const { source, target } = this.begun;
    if (!source || !target) return this.tell();
    this.add({ source, target });
  }

  add(points) {
    if (this.all.length >= MOST) return;
    this.begun = {};
    this.changed([...this.all, { name: `Landmark ${this.all.length + 1}`, ...points }]);
  }

  /** Take back the last click, or the last landmark. */
  undo() {
    if (Object.keys(this.begun).length) {
      this.begun = {};
      return this.tell();
    }
    return this.put(this.all.slice(0, -1));
  }

  put(all) {
    this.changed(all.length ? all : undefined);
  }

  tell() {
    const { source, target } = this.begun;
    const none = !source && !target && this.all.length === 0;
    if (none && document.activeElement === this.back) this.toggle.focus();
    this.back.disabled = none;
    const full = this.all.length >= MOST && `At most ${MOST} are allowed.`;
    const next = source
      ? "Now click the point of the target where it ends."
      : target
        ? "Now click the point of the source that ends there."
        : "Click a point of the source, then one of the target. Dragging still turns the views.";
    fill(this.said, full || (this.picking ? next : ""));
    for (const end of ENDS) this.mark(end);
  }

  mark(end) {
    const marks = this.element.hidden ? [] : this.all.map((landmark, index) => ({ at: landmark[end], index }));
    if (this.begun[end]) marks.push({ at: this.begun[end], index: this.all.length });
    this.previews[end].mark(marks);
  }

  row(landmark, index) {
    const change = (name, value) => this.put(this.all.with(index, { ...landmark, [name]: value }));
    const point = (end) => {
      const typed = ({ target: input }) => {
        const values = input.value.split(/[\s,;]+/).filter(Boolean).map(Number);
        const fine = values.length === 3 && values.every(Number.isFinite);
        input.toggleAttribute("aria-invalid", false);
        if (fine) return change(end, values);
        input.setAttribute("aria-invalid", "true");
        return fill(this.said, "Enter three numbers separated by commas: x, y, z.");
      };
      return this.input(`${end}-${index}`, `Point of the ${end}`, landmark[end].join(", "), typed);
    };
    const named = ({ target: input }) => change("name", input.value.trim());
    const name = this.input(`name-${index}`, "Name", landmark.name ?? "", named);
    name.querySelector("input").maxLength = 60;
    const remove = () => this.put(this.all.toSpliced(index, 1));
    const dot = h("span", { class: "mark" }, index + 1);
    dot.style.background = markColour(index);
    return h(
      "li",
      null,
      dot,
      name,
      point("source"),
      point("target"),
      h(
        "button",
        {
          type: "button",
          id: `landmark-remove-${index}`, // by which it keeps the focus
          class: "compact",
          "aria-label": `Remove landmark ${index + 1}`,
          on: { click: remove },
        },
        "Remove",
      ),
    );
  }

  input(id, label, value, change) {
    const input = h("input", { id: `landmark-${id}`, type: "text", value, autocomplete: "off", on: { change } });
    return h("label", null, label, input);
  }
}
