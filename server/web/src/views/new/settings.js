/** All settings in groups, closed until somebody wants them. */

import { fill, h, reveal } from "../../dom.js";
import { plural } from "../../format.js";
import { Setting } from "./setting.js";

const ELSEWHERE = new Set(["preset"]);

/** The settings of the form: a few beside the form's own fields, all others behind a summary. */
export class Settings {
  /**
   * @param {Array<object>} abouts as `settings` of schema.js makes them
   * @param {Record<string, string>} main titles of the settings that stand outside, by path; `main` has their fields
   * @param {(path: string, value: any) => void} changed hears a value, undefined for the preset's
   */
  constructor(abouts, main, changed) {
    this.fields = new Map();
    const groups = new Map();
    for (const about of abouts) {
      if (ELSEWHERE.has(about.path)) continue;
      const title = main[about.path];
      const field = new Setting(about, (value) => changed(about.path, value), { title });
      this.fields.set(about.path, field);
      if (title) continue;
      if (!groups.has(about.group)) groups.set(about.group, { meaning: about.groupMeaning, fields: [] });
      groups.get(about.group).fields.push(field);
    }
    this.main = Object.fromEntries(Object.keys(main).map((path) => [path, this.fields.get(path).element]));
    this.groups = [...groups].map(([name, group]) => ({ ...group, element: section(name, group) }));
    this.count = h("span", { class: "quiet small" });
    this.nothing = h("p", { class: "quiet", hidden: true }, "No settings match.");
    this.methods = [];
    this.search = h("input", {
      type: "search",
      id: "find-setting",
      autocomplete: "off",
      on: { input: () => this.find(this.search.value) },
    });
    this.element = h(
      "details",
      { class: "panel advanced" },
      h("summary", null, h("h2", null, "All settings"), this.count),
      h(
        "div",
        { class: "stack" },
        h("div", { class: "field" }, h("label", { for: "find-setting" }, "Find a setting"), this.search),
        this.nothing,
        this.groups.map(({ element }) => element),
      ),
    );
  }

  /** Show the settings of methods: the values of a preset with overrides. */
  show(preset, overrides, methods) {
    this.methods = methods;
    for (const [path, field] of this.fields) {
      if (!this.applies(field)) continue;
      const value = path in overrides ? overrides[path] : preset[path];
      field.show(value, preset[path]);
    }
    const size = Object.keys(this.applying(overrides)).length;
    fill(this.count, size ? `${plural(size, "setting")} changed` : "");
    this.find(this.search.value);
  }

  /** Those of some overrides that the chosen methods have. */
  applying(overrides) {
    const kept = Object.entries(overrides).filter(([path]) => {
      const field = this.fields.get(path);
      return !field || this.applies(field);
    });
    return Object.fromEntries(kept);
  }

  /** The first setting with a fault, if any. */
  get wrong() {
    return [...this.fields.values()].find((field) => field.wrong && this.applies(field));
  }

  applies({ about: { methods } }) {
    return !methods || this.methods.some((name) => methods.has(name));
  }

  /**
   * Put a problem of the service beside the settings that it names.
   *
   * @returns {boolean} whether it names one
   */
  fault(problem) {
    let first = null;
    const named = new Map(problem.errors.map(({ loc, msg }) => [loc.join("."), `${msg}.`]));
    for (const [path, field] of this.fields) {
      const [, text] = problem.message.split(`${path} = `);
      const said = text?.split(";")[0] ?? named.get(path) ?? named.get(`overrides.${path}`);
      if (!said) continue;
      field.fault(said, false);
      first ??= field;
    }
    if (!first) return false;
    reveal(first.element);
    first.input.focus();
    return true;
  }

  find(text) {
    const wanted = text.trim().toLowerCase();
    let any = false;
    for (const { fields, element } of this.groups) {
      for (const field of fields) {
        field.element.hidden = !this.applies(field) || !field.matches(wanted);
      }
      element.hidden = fields.every((field) => field.element.hidden);
      any ||= !element.hidden;
    }
    this.nothing.hidden = any;
  }
}

function section(name, { meaning, fields }) {
  return h(
    "fieldset",
    { class: "group" },
    h("legend", null, h("h3", null, name)),
    meaning && h("p", { class: "quiet small" }, meaning),
    h("div", { class: "grid" }, fields.map((field) => field.element)),
  );
}
