/** A new morph: two shapes, how to move between them, and off it goes. */

import { get, post } from "../../api.js";
import { fill, h } from "../../dom.js";
import { bytes, duration, plural } from "../../format.js";
import { freshKey } from "../../idempotency.js";
import { go, replaceQuery, setTitle } from "../../navigation.js";
import { problemNotice } from "../../problem_notice.js";
import { TITLES } from "../../setting_titles.js";
import { Chooser } from "./chooser.js";
import { fromJob, fromQuery, settingsOf, toQuery, toRequest } from "./draft.js";
import { Methods } from "./methods.js";
import { settings } from "./schema.js";
import { Settings } from "./settings.js";
import "./new.css";

const FIT = "sampling.fit";

export async function show(root, params, signal) {
  setTitle("New morph");
  fill(root, h("h1", null, "New morph"), h("p", { class: "quiet", role: "status" }, "One moment."));
  const [methods, presets, shapes, schema] = await Promise.all(
    ["/methods", "/presets", "/shapes", "/schemas/config"].map((path) => get(path, { signal })),
  );
  const draft = params.like ? await like(params.like, signal) : fromQuery(params);
  if (draft.methods.length === 0) draft.methods = [methods[0].name];
  const form = new Form({ methods, presets, shapes, schema }, draft, signal);
  await form.valuesOf(draft); // a form that filled itself later would write over what is typed
  fill(root, form.element);
  await form.changed({});
}

async function like(id, signal) {
  const [job, config] = await Promise.all([
    get(`/jobs/${id}`, { signal }),
    get(`/jobs/${id}/config`, { signal }),
  ]);
  const preset = await get(`/presets/${job.preset}`, { query: { method: job.method }, signal });
  return fromJob(job, config, preset.config);
}

class Form {
  constructor({ methods, presets, shapes, schema }, draft, signal) {
    Object.assign(this, { draft, signal });
    this.key = freshKey();
    this.presets = new Map();
    const heard = (role) => ({
      changed: (shape) => this.changed({ [role]: shape }),
      unsettled: () => this.unsettled(),
      placed: (message) => message && this.showFit(message),
    });
    this.fitting = h("p", { class: "notice fitting", role: "status", hidden: true });
    this.source = new Chooser("source", "From", shapes, heard("source"), signal);
    this.target = new Chooser("target", "To", shapes, heard("target"), signal);
    this.methods = new Methods(methods, (names) => this.changed({ methods: names }));
    this.settings = new Settings(settings(schema), TITLES, (path, value) => this.set(path, value));
    this.preset = this.presetField(presets);
    this.name = h("input", {
      id: "name",
      type: "text",
      maxlength: 200,
      autocomplete: "off",
      on: { change: (event) => this.changed({ name: event.target.value.trim() }) },
    });
    this.trouble = h("div");
    this.cost = h("p", { class: "quiet" });
    this.submit = h("button", { class: "primary", type: "submit" });
    this.element = h(
      "form",
      { class: "stack new", novalidate: true, on: { submit: (event) => this.send(event) } },
      h("h1", null, "New morph"),
      h("div", { class: "shapes" }, this.source.element, this.target.element),
      this.fitting,
      h("section", { class: "stack part" }, this.methods.element),
      h(
        "section",
        { class: "stack part" },
        h("h2", null, "Run"),
        h(
          "div",
          { class: "grid" },
          this.preset.element,
          this.settings.main,
          h(
            "div",
            { class: "field" },
            h("label", { for: "name" }, "Name"),
            this.name,
            h("p", { class: "hint" }, "For your own use; may stay empty."),
          ),
        ),
      ),
      this.settings.element,
      this.trouble,
      h("div", { class: "spread send" }, this.cost, this.submit),
    );
  }

  /** Take a change into the draft, keep it in the address, and show it. */
  async changed(change) {
    try {
      await this.take(change);
      fill(this.trouble);
    } catch (error) {
      if (this.signal.aborted) return;
      if (error.name !== "Problem") throw error;
      fill(this.trouble, problemNotice(error));
    }
  }

  async take(change) {
    this.draft = { ...this.draft, ...change };
    this.key = freshKey();
    replaceQuery(toQuery(this.draft));
    if (change.source || change.target) this.unsettled();
    const before = this.draft;
    const values = await this.valuesOf(this.draft);
    if (this.signal.aborted || this.draft !== before) return; // a newer change shows itself
    const { source, target, methods, preset, name, overrides } = this.draft;
    this.settings.show(values, overrides, methods);
    const value = (path) => overrides[path] ?? values[path];
    const edge = value("sampling.points_per_cell_edge");
    const fit = value(FIT);
    const sampling = { points_per_cell_edge: edge, fit };
    if (fit !== this.fit) this.hideFit();
    this.fit = fit;
    this.source.show(source, sampling, target);
    this.target.show(target, sampling, source);
    if (fit === "none" && (source.mesh || target.mesh)) this.showNoFit(FIT in overrides);
    this.methods.show(methods);
    this.preset.show(preset);
    if (document.activeElement !== this.name) this.name.value = name;
    const jobs = methods.length;
    fill(this.submit, jobs === 1 ? "Morph" : `Morph with ${jobs} methods`);
    this.showCost(source, edge, fit, value("frames"));
  }

  /** What was said of the shapes holds no longer. */
  unsettled() {
    this.hideFit();
    fill(this.cost);
    this.costOf = null;
  }

  hideFit() {
    this.fitting.hidden = true;
    fill(this.fitting);
  }

  /** Say what the fit does, with a way to leave the shapes as they are. */
  showFit(message) {
    if (this.source.missing() || this.target.missing()) return;
    const keep = async () => {
      await this.set(FIT, "none");
      this.fitting.querySelector("button")?.focus(); // of the way back
    };
    this.sayFit(message, "Keep shapes as they are", keep);
  }

  showNoFit(overridden) {
    if (this.source.missing() || this.target.missing()) return;
    const back = () => this.set(FIT, overridden ? undefined : "auto");
    this.sayFit("Shapes keep the size and place that they have in their files.", "Scale and centre them", back);
  }

  sayFit(text, label, act) {
    if (this.fitting.firstChild?.textContent === text) return; // which may have the focus
    const button = h("button", { type: "button", class: "compact", on: { click: act } }, label);
    fill(this.fitting, h("span", null, text), " ", button);
    this.fitting.hidden = false;
  }

  set(path, value) {
    const { [path]: before, ...overrides } = this.draft.overrides;
    if (value !== undefined) overrides[path] = value;
    return this.changed({ overrides });
  }

  /** Values of a preset; where methods differ, that of the first one chosen. */
  async valuesOf({ preset, methods }) {
    const ofMethods = await Promise.all(methods.map((method) => this.presetOf(preset, method)));
    return Object.assign({}, ...ofMethods.reverse());
  }

  presetOf(preset, method) {
    const key = `${preset}/${method}`;
    if (!this.presets.has(key)) {
      const asked = get(`/presets/${preset}`, { query: { method }, signal: this.signal });
      this.presets.set(key, asked.then(({ config }) => settingsOf(config)));
      asked.catch(() => this.presets.delete(key));
    }
    return this.presets.get(key);
  }

  presetField(presets) {
    const hint = h("p", { class: "hint", id: "preset-hint" });
    const select = h(
      "select",
      {
        id: "preset",
        "aria-describedby": "preset-hint",
        on: { change: (event) => this.changed({ preset: event.target.value }) },
      },
      presets.map(({ name }) => h("option", { value: name }, name)),
    );
    const element = h(
      "div",
      { class: "field" },
      h("label", { for: "preset" }, "Preset"),
      select,
      hint,
    );
    const show = (name) => {
      select.value = name;
      fill(hint, presets.find((one) => one.name === name)?.description);
    };
    return { element, show };
  }

  async showCost(source, edge, fit, frames) {
    fill(this.cost);
    const own = (this.costOf = {});
    if (!source.mesh || fit !== "auto" || this.source.missing()) return;
    const mesh = await get(`/meshes/${source.mesh}`, { signal: this.signal }).catch(() => null);
    const seen = mesh?.report.resolutions.find((one) => one.points_per_cell_edge === edge);
    if (!seen || this.costOf !== own) return; // it is told of what is chosen by now
    const { seconds, memory_mb: memory } = seen.estimate;
    fill(
      this.cost,
      `Usually about ${duration(seconds)} for 40 frames, and ${bytes(memory * 1e6)} of memory`,
      frames === 40 ? "." : `; you ask for ${plural(frames, "frame")}.`,
    );
  }

  async send(event) {
    event.preventDefault();
    if (this.source.complains() || this.target.complains()) return;
    const { wrong } = this.settings;
    if (wrong) {
      if (this.settings.element.contains(wrong.element)) this.settings.element.open = true;
      return wrong.input.focus();
    }
    if (this.sending) return; // a double click is one job
    this.sending = true;
    this.submit.setAttribute("aria-disabled", "true");
    fill(this.trouble);
    try {
      const overrides = this.settings.applying(this.draft.overrides);
      const [path, body] = toRequest({ ...this.draft, overrides });
      const made = await post(path, body, { idempotencyKey: this.key, signal: this.signal });
      go(path === "/jobs" ? `/jobs/${made.id}` : `/?sweep=${made.id}`);
    } catch (error) {
      if (error.name !== "Problem") throw error;
      if (!this.settings.fault(error)) fill(this.trouble, problemNotice(error));
    } finally {
      this.sending = false;
      this.submit.removeAttribute("aria-disabled");
    }
  }
}
