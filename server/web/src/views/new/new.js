/** A new morph: two shapes, how to move between them, and off it goes. */

import { get, post } from "../../api.js";
import { choice, offer } from "../../choice.js";
import { methodsWith, settings } from "../../config_schema.js";
import { fill, h, reveal } from "../../dom.js";
import { bytes, duration } from "../../format.js";
import { freshKey } from "../../idempotency.js";
import { go, replaceQuery, setTitle } from "../../navigation.js";
import { problemNotice } from "../../problem_notice.js";
import { TITLES, learnTitles } from "../../setting_titles.js";
import { Chooser } from "./chooser.js";
import { fromJob, fromQuery, settingsOf, toQuery, toRequest } from "./draft.js";
import { Methods } from "./methods.js";
import { AS_IT_IS, posesOf } from "./pose.js";
import { Landmarks } from "./landmarks.js";
import { research } from "./research.js";
import { Seconds } from "./seconds.js";
import { Settings } from "./settings.js";
import "./new.css";

const FIT = "sampling.fit";
const EDGE = "sampling.points_per_cell_edge";
const FINENESS = [
  ["2", "Draft"],
  ["3", "Normal"],
  ["4", "Fine"],
  ["5", "Finest"],
];
const MATTER = [
  ["fast", "Normal"],
  ["stiff", "Stiff"],
  ["soft", "Soft"],
  ["viscous", "Viscous"],
  ["fluid", "Drop"],
];
const OTHER = ["", "Set under Research"];
const FRAMES = "frames";
const ESTIMATED_FRAMES = 40; // that the service tells the cost of
const LANDMARKS = "landmarks";
const FIRST_BETWEEN = { shape: "torus" };
const MOST_BETWEEN = 8; // the service takes more

export async function show(root, params, signal) {
  setTitle("New morph");
  fill(root, h("h1", null, "New morph"), h("p", { class: "quiet", role: "status" }, "Loading…"));
  const [methods, presets, shapes, schema] = await Promise.all(
    ["/methods", "/presets", "/shapes", "/schemas/config"].map((path) => get(path, { signal })),
  );
  const draft = params.like ? await like(params.like, signal) : fromQuery(params);
  if (draft.methods.length === 0) draft.methods = [methods[0].name];
  const form = new Form({ methods, presets, shapes, schema }, draft, signal);
  if (!isPlain(draft, methods[0].name)) form.research.open = true;
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
    this.flowing = methods[0].name; // the presets of matter are its own
    this.shapes = shapes;
    const heard = (role) => ({
      changed: (shape) => this.changed({ [role]: shape, ...this.withoutMarks(role, shape) }),
      unsettled: () => this.unsettled(),
      placed: (about) => this.showPlacement(about),
      posed: (changes) => this.setAll(changes),
    });
    this.between = [];
    this.more = h(
      "button",
      { type: "button", class: "compact", on: { click: () => this.changed({ via: [...this.draft.via, FIRST_BETWEEN] }) } },
      "Add a shape in between",
    );
    this.ends = h("div", { class: "shapes" });
    this.fitting = h("p", { class: "notice fitting", role: "status", hidden: true });
    this.turning = h("p", { class: "notice fitting", role: "status", hidden: true });
    this.source = new Chooser("source", "From", shapes, heard("source"), signal);
    this.target = new Chooser("target", "To", shapes, heard("target"), signal);
    this.landmarks = new Landmarks(this.source, this.target, (landmarks) => this.set(LANDMARKS, landmarks));
    this.marking = methodsWith(LANDMARKS, schema);
    this.methods = new Methods(methods, (names) => this.changed({ methods: names }));
    const abouts = settings(schema);
    learnTitles(abouts);
    this.settings = new Settings(abouts, TITLES, (path, value) => this.set(path, value));
    this.preset = this.presetField(presets);
    this.seconds = new Seconds(schema.properties[FRAMES].maximum, (frames) => this.set(FRAMES, frames));
    const taken = (path, number) => ({ target }) => target.value && this.set(path, number(target.value));
    this.fineness = choice("fineness", "Fineness", [...FINENESS, OTHER], { change: taken(EDGE, Number) });
    const matter = ({ target }) => target.value && this.changed({ preset: target.value });
    this.matter = choice("matter", "Matter", [...MATTER, OTHER], { change: matter });
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
      this.ends,
      h("div", { class: "row" }, this.more),
      this.fitting,
      this.turning,
      this.landmarks.element,
      h(
        "section",
        { class: "stack part", "aria-label": "The morph" },
        h(
          "div",
          { class: "grid" },
          this.matter.field,
          this.fineness.field,
          this.seconds.element,
          h(
            "div",
            { class: "field" },
            h("label", { for: "name" }, "Name"),
            this.name,
            h("p", { class: "hint" }, "Optional."),
          ),
        ),
      ),
      (this.research = research(
        this.methods.element,
        h("h3", null, "Run"),
        h("div", { class: "grid" }, this.preset.element, this.settings.main[FRAMES], this.settings.main[EDGE], this.settings.main[FIT]),
        this.settings.element,
      )),
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
    if (change.source || change.target || change.via) this.unsettled();
    this.showBetween();
    const before = this.draft;
    const values = await this.valuesOf(this.draft);
    if (this.signal.aborted || this.draft !== before) return; // a newer change shows itself
    const { source, via, target, methods, preset, name, overrides } = this.draft;
    this.settings.show(values, overrides, methods);
    const value = (path) => overrides[path] ?? values[path];
    const edge = value(EDGE);
    const fit = value(FIT);
    const sampling = { points_per_cell_edge: edge, fit };
    if (fit !== this.fit) this.hideFit();
    this.fit = fit;
    const posed = (...roles) => ({ ...sampling, placement: posesOf(overrides, ...roles) });
    this.source.show(source, posed("source", "target"), target, this.poseOf("source"));
    this.target.show(target, posed("target", "source"), source, this.poseOf("target"));
    this.between.forEach(({ chooser }, index) => chooser.show(via[index], posed("source"), source));
    this.landmarks.show(overrides[LANDMARKS] ?? [], this.takesLandmarks());
    if (fit === "none" && (source.mesh || target.mesh)) this.showNoFit(FIT in overrides);
    this.methods.show(methods);
    this.preset.show(preset);
    choose(this.matter.select, preset);
    choose(this.fineness.select, String(edge));
    this.matter.field.hidden = !methods.includes(this.flowing);
    if (document.activeElement !== this.name) this.name.value = name;
    const jobs = methods.length;
    fill(this.submit, jobs === 1 ? "Morph" : `Morph with ${jobs} methods`);
    this.seconds.show(value(FRAMES), via.length + 1);
    this.showCost(source, edge, fit, value(FRAMES) * (via.length + 1));
  }

  /** A card for each shape between source and target, as many as the draft has. */
  showBetween() {
    const { via } = this.draft;
    if (this.ends.children.length === via.length + 2) return;
    while (this.between.length < via.length) this.between.push(this.oneBetween(this.between.length));
    const cards = this.between.map(({ chooser }) => chooser.element);
    fill(this.ends, this.source.element, ...cards, this.target.element);
    this.more.disabled = via.length >= MOST_BETWEEN;
  }

  oneBetween(index) {
    const ending = new AbortController();
    const changed = (shape) => this.changed({ via: this.draft.via.with(index, shape) });
    const heard = { changed, unsettled: () => this.unsettled(), placed: () => {} };
    const there = AbortSignal.any([this.signal, ending.signal]);
    const noun = `shape number ${index + 2}`;
    const chooser = new Chooser(`via-${index}`, `Through (${index + 1})`, this.shapes, heard, there, noun);
    const remove = () => {
      // the cards after it are made anew, since they have other numbers
      for (const { ending } of this.between.splice(index)) ending.abort();
      this.changed({ via: this.draft.via.toSpliced(index, 1) });
      this.more.focus();
    };
    const label = `Remove ${noun}`;
    chooser.element.append(
      h("button", { type: "button", class: "compact", on: { click: remove } }, label),
    );
    return { chooser, ending };
  }

  /** What was said of the shapes holds no longer. */
  unsettled() {
    this.hideFit();
    fill(this.cost);
    this.costOf = null;
  }

  hideFit() {
    for (const notice of [this.fitting, this.turning]) {
      notice.hidden = true;
      fill(notice);
    }
  }

  /** How an end is turned, scaled and moved. */
  poseOf(role) {
    const names = Object.keys(AS_IT_IS);
    return Object.fromEntries(
      names.map((name) => [name, this.draft.overrides[`placement.${role}.${name}`] ?? AS_IT_IS[name]]),
    );
  }

  /** Say what is done to the shapes unasked. */
  showPlacement({ message, turning, up }) {
    if (this.source.missing() || this.target.missing()) return;
    if (message && !this.between.length) this.showFit(message);
    if (!turning) return say(this.turning, "");
    const keep = () => this.setAll({ "placement.source.up": up, "placement.target.up": up });
    say(this.turning, turning, "Keep both as they are", keep);
  }

  /** Say what the fit does, with a way to leave the shapes as they are. */
  showFit(message) {
    const keep = async () => {
      await this.set(FIT, "none");
      this.fitting.querySelector("button")?.focus(); // of the way back
    };
    say(this.fitting, message, "Keep shapes as they are", keep);
  }

  showNoFit(overridden) {
    if (this.source.missing() || this.target.missing()) return;
    const back = () => this.set(FIT, overridden ? undefined : "auto");
    const text = "Shapes keep the size and position from their files.";
    say(this.fitting, text, "Scale and centre them", back);
  }

  /** Points of another shape are none of this one. */
  withoutMarks(role, shape) {
    const { [LANDMARKS]: marks, ...overrides } = this.draft.overrides;
    const same = JSON.stringify(shape) === JSON.stringify(this.draft[role]);
    return marks && !same ? { overrides } : {};
  }

  /** Whether a chosen method heeds landmarks, which belong to one pair of shapes. */
  takesLandmarks() {
    const { methods, via } = this.draft;
    return via.length === 0 && methods.some((name) => this.marking.has(name));
  }

  set(path, value) {
    return this.setAll({ [path]: value });
  }

  /** Take settings by their paths, undefined for those of the preset. */
  setAll(changes) {
    const kept = Object.entries({ ...this.draft.overrides, ...changes }).filter(([, value]) => value !== undefined);
    return this.changed({ overrides: Object.fromEntries(kept) });
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
    const longer = Math.max(frames / ESTIMATED_FRAMES, 1); // much of a short one is its beginning
    fill(this.cost, `Usually takes about ${duration(seconds * longer)}, with ${bytes(memory * 1e6)} of memory.`);
  }

  async send(event) {
    event.preventDefault();
    const choosers = [this.source, ...this.between.map(({ chooser }) => chooser), this.target];
    if (choosers.some((chooser) => chooser.complains())) return;
    if (this.between.length && this.draft.methods.length > 1) {
      const words = "A morph through several shapes can use only one method: choose one, or remove the shapes in between.";
      return fill(this.trouble, h("p", { class: "notice bad", role: "alert" }, words));
    }
    const wrong = this.seconds.wrong ? this.seconds : this.settings.wrong;
    if (wrong) {
      reveal(wrong.element);
      return wrong.input.focus();
    }
    if (this.sending) return; // a double click is one job
    this.sending = true;
    this.submit.setAttribute("aria-disabled", "true");
    fill(this.trouble);
    try {
      const { [LANDMARKS]: marks, ...overrides } = this.settings.applying(this.draft.overrides);
      if (marks && this.takesLandmarks()) overrides[LANDMARKS] = marks;
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

/** Whether all of a draft can be seen without what is under Research. */
function isPlain({ methods, preset, overrides }, usual) {
  const among = (all, value) => all.some(([one]) => one === String(value));
  return (
    methods.every((name) => name === usual) &&
    among(MATTER, preset) &&
    Object.entries(overrides).every(([path, value]) => {
      if (path === EDGE) return among(FINENESS, value);
      return path === FRAMES || path === LANDMARKS || path.startsWith("placement.");
    })
  );
}

/** Choose of a list what a value is there, or else that it is none of them. */
function choose(select, value) {
  const known = [...select.options].some((option) => option.value === value);
  offer(select, (one) => one !== OTHER[0] || !known);
  select.value = known ? value : OTHER[0];
}

/** Say something with a way out of it, or nothing. */
function say(notice, text, label, act) {
  notice.hidden = !text;
  if (!text) return fill(notice);
  if (notice.firstChild?.textContent === text) return notice; // which may have the focus
  const button = h("button", { type: "button", class: "compact", on: { click: act } }, label);
  return fill(notice, h("span", null, text), " ", button);
}
