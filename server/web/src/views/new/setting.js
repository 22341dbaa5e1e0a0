/** One setting: its input, what it means, and what is wrong with it. */

import { fill, h } from "../../dom.js";

/** A labelled input made from the schema of a setting. */
export class Setting {
  /**
   * @param {object} about as `settings` of schema.js describes it
   * @param {(value: any) => void} changed hears a value that is allowed, undefined for the preset's
   * @param {{title?: string}} options another title than the schema's
   */
  constructor(about, changed, { title } = {}) {
    this.about = about;
    this.title = title ?? about.title;
    this.changed = changed;
    const id = `set-${about.path}`;
    this.typing = false; // what is half typed is nobody else's to change
    this.input = input(about, id, {
      input: () => (this.typing = true),
      blur: () => (this.input.validity.badInput ? this.read() : (this.typing = false)), // of half a number no change is told
      change: () => this.read(),
    });
    this.trouble = h("p", { class: "fault", id: `${id}-fault`, role: "alert" });
    this.preset = h("button", { class: "plain compact", type: "button", on: { click: () => this.reset() } });
    const hint = [about.meaning, about.range && sentence(about.range)].filter(Boolean).join(" ");
    const unit = about.unit && h("span", { class: "quiet unit" }, ` [${about.unit}]`);
    const label = h("label", { for: id }, this.title, unit);
    this.input.setAttribute("aria-describedby", `${id}-hint ${id}-fault`);
    this.element = h(
      "div",
      { class: "field setting" },
      about.kind === "boolean" ? h("div", { class: "row" }, this.input, label) : label,
      about.kind !== "boolean" && this.input,
      h("p", { class: "hint", id: `${id}-hint` }, hint),
      this.trouble,
      this.preset,
    );
  }

  /** Show a value and the one of the preset; what is typed and wrong stays to be mended. */
  show(value, preset) {
    if (this.wrong) return;
    this.value = value;
    this.presetValue = preset;
    if (this.about.kind === "boolean") this.input.checked = value;
    else if (!this.typing) this.input.value = written(value);
    const other = JSON.stringify(value) !== JSON.stringify(preset);
    this.element.classList.toggle("changed", other);
    this.preset.hidden = !other;
    fill(this.preset, `Back to ${shown(preset)}`);
    this.preset.setAttribute("aria-label", `${this.title}: back to ${shown(preset)}`);
    this.fault("");
  }

  /** Say what is wrong with the value; it is `wrong` itself if no other setting can mend it. */
  fault(text, wrong = Boolean(text)) {
    fill(this.trouble, text);
    this.wrong = wrong;
    this.input.toggleAttribute("aria-invalid", false);
    if (text) this.input.setAttribute("aria-invalid", "true");
  }

  /** Whether a text occurs in its name or its meaning. */
  matches(text) {
    const { path, title, meaning } = this.about;
    return `${path} ${title} ${meaning}`.toLowerCase().includes(text);
  }

  reset() {
    this.fault("");
    this.changed(undefined);
    this.input.focus();
  }

  read() {
    const { about } = this;
    this.typing = false;
    this.fault("");
    const text = about.kind === "boolean" ? "" : this.input.value.trim();
    let value;
    if (about.kind === "boolean") value = this.input.checked;
    else if (text === "" && about.nullable && !this.input.validity.badInput) value = null;
    else if (about.kind === "integer" || about.kind === "number") {
      value = Number(text);
      if (text === "" || !this.input.checkValidity() || !Number.isFinite(value)) {
        const noun = about.kind === "integer" ? "a whole number" : "a number";
        return this.fault(sentence(`enter ${noun} ${about.range}`.trim()));
      }
    } else if (about.kind === "array") {
      value = text.split(/[\s,;]+/).map(Number);
      if (value.some((one) => !Number.isFinite(one))) {
        return this.fault("Enter numbers separated by commas.");
      }
    } else value = text;
    return this.changed(JSON.stringify(value) === JSON.stringify(this.presetValue) ? undefined : value);
  }
}

function input(about, id, on) {
  const { schema, kind } = about;
  if (kind === "boolean") return h("input", { id, type: "checkbox", on });
  if (kind === "choice") {
    return h(
      "select",
      { id, on },
      schema.enum.map((one) => h("option", { value: one }, one.replaceAll("_", " "))),
    );
  }
  if (kind === "array") return h("input", { id, type: "text", autocomplete: "off", on });
  return h("input", {
    id,
    type: "number",
    inputmode: kind === "integer" ? "numeric" : "decimal",
    step: kind === "integer" ? 1 : "any",
    min: schema.minimum ?? schema.exclusiveMinimum,
    max: schema.maximum ?? schema.exclusiveMaximum,
    autocomplete: "off",
    on,
  });
}

function written(value) {
  if (value === null || value === undefined) return "";
  return Array.isArray(value) ? value.join(", ") : String(value);
}

function shown(value) {
  if (value === true) return "on";
  if (value === false) return "off";
  return written(value) || "none";
}

function sentence(text) {
  return `${text[0].toUpperCase()}${text.slice(1)}.`;
}
