/** Files of a job: what is there already, and exports that are made on demand. */
import { Problem, get, passes, pause, post, save } from "../../api.js";
import { choice, offer } from "../../choice.js";
import { fill, h } from "../../dom.js";
import { bytes, jobFileName, lives, percent } from "../../format.js";
import { COLOURS } from "../../viewer/colors.js";
import { shared } from "../../share_link.js";
import { problemNotice } from "../../problem_notice.js";
import { PictureOptions } from "./picture_options.js";

const ASK_MILLISECONDS = 500;
const USUAL_FORMAT = "glb"; // other programs play it

/** The section; `update` tells it of the job. */
export class Downloads {
  /**
   * @param {object} options
   * @param {string} options.jobId
   * @param {import("../../viewer/panel.js").Panel} options.panel
   * @param {import("../../viewer/timeline.js").Timeline} options.timeline tells the frame shown.
   * @param {import("../../viewer/pace.js").Pace} options.pace tells in what time all is played.
   * @param {AbortSignal} options.signal
   */
  constructor({ jobId, panel, timeline, pace, signal }) {
    Object.assign(this, { jobId, timeline, pace, signal });
    const share = () => this.frame() / Math.max(timeline.count - 1, 1);
    this.picture = new PictureOptions({ panel, share });
    this.trouble = h("div");
    this.files = h("div", { class: "row" });
    this.exports = h("div", { class: "stack exports" });
    this.element = h(
      "section",
      { class: "panel stack", "aria-labelledby": "downloads" },
      h("h2", { id: "downloads" }, "Downloads"),
      this.files,
      this.exports,
      this.trouble,
    );
    if (!shared()) this.#offerExports();
  }

  /** @returns {number} index of the frame shown. */
  frame() {
    return Math.max(this.timeline.index, 0);
  }

  /** @param {object} job as it is now. */
  update(job) {
    this.job = job;
    const shown = JSON.stringify([job.state, job.progress.frame > 0]);
    if (shown === this.shown) return;
    this.shown = shown;
    const some = job.progress.frame > 0;
    const root = `/jobs/${this.jobId}`;
    const named = () => jobFileName(this.job);
    const size = job.outcome ? `, ${bytes(job.outcome.size_bytes)}` : "";
    fill(
      this.files,
      !lives(job.state) &&
        some &&
        this.#file(`Result, VTKHDF${size}`, `${root}/result`, () => `${named()}.vtkhdf`),
      some &&
        this.#file(
          "This frame, PLY in grid units",
          () => `${root}/frames/${this.frame()}`,
          () => `${named()}-frame-${this.frame() + 1}.ply`,
          { format: "ply" },
        ),
      some &&
        this.#file(
          "Surface of this frame, GLB in your units",
          () => `${root}/frames/${this.frame()}/surface`,
          () => `${named()}-surface-${this.frame() + 1}.glb`,
          { format: "glb", units: "user" },
        ),
      some && this.#file("Metrics, CSV", `${root}/metrics`, () => `${named()}-metrics.csv`, { format: "csv" }),
      !shared() && this.#file("Log", `${root}/log`, () => `${named()}-log.txt`),
    );
    this.exports.hidden = !some || shared();
  }

  #file(label, path, name, query) {
    const click = async (event) => {
      const pressed = event.currentTarget;
      pressed.disabled = true;
      fill(this.trouble);
      try {
        const address = typeof path === "function" ? path() : path;
        await save(address, name(), { query, signal: this.signal });
      } catch (error) {
        this.#fault(error);
      } finally {
        pressed.disabled = false;
      }
    };
    return h("button", { type: "button", class: "compact", on: { click } }, label);
  }

  async #offerExports() {
    let formats;
    try {
      formats = await get("/exports/formats", { signal: this.signal });
    } catch {
      return; // a service without exports
    }
    const chosen = () => formats.find((one) => one.name === format.select.value);
    const holds = (what) => content.select.value === what && chosen().carries.includes(what);
    const moving = () => holds("tracked");
    const reflect = () => {
      const { carries, description, kind } = chosen();
      explain.textContent = `${description}.`;
      content.field.hidden = offer(content.select, (value) => carries.includes(value)) < 2;
      frames.field.hidden = kind === "table" || moving();
      frames.select.value = kind === "frame" ? "this" : "all";
      fields.field.hidden = !carries.includes("fields") || moving();
      units.field.hidden = kind === "table" || carries.includes("picture");
      this.picture.offer(carries);
      ends.field.hidden = !holds("surface") && !moving();
      colours.field.hidden = !carries.includes("texture") || !moving();
    };
    const names = formats.map((one) => [one.name, one.name.toUpperCase()]);
    const format = choice("export-format", "Format", names, { change: reflect });
    const contents = [
      ["tracked", "Moving mesh"],
      ["surface", "Surface"],
      ["points", "Particles"],
    ];
    const content = choice("export-content", "Content", contents, { change: reflect });
    const frames = choice("export-frames", "Frames", [
      ["this", "The current one"],
      ["all", "All"],
    ]);
    const fields = choice("export-values", "Values", [
      ["", "None"],
      ...Object.entries(COLOURS)
        .filter(([name]) => name !== "height")
        .map(([name, { label }]) => [name, label]),
    ]);
    const units = choice("export-lengths", "Lengths in", [
      ["user", "Your units"],
      ["source", "Units of the source"],
      ["target", "Units of the target"],
      ["grid", "Grid units"],
    ]);
    const colours = choice("export-colours", "Colours", [
      ["", "Per vertex"],
      ["1024", "As textures, 1024 pixels"],
      ["2048", "As textures, 2048 pixels"],
    ]);
    const ends = choice("export-ends", "First and last frame", [
      ["matter", "As computed"],
      ["meshes", "Snapped to meshes"],
    ]);
    format.select.value = USUAL_FORMAT;
    const explain = h("p", { class: "quiet small" });
    const made = h("div", { class: "stack", role: "status" });
    const submit = async (event) => {
      event.preventDefault();
      const { kind, carries } = chosen();
      const tracked = moving();
      const one = kind !== "table" && !tracked && frames.select.value === "this";
      const timed = !one && chosen().timed && (kind !== "frame" || tracked);
      const state = h("div", { class: "stack" });
      made.prepend(state);
      await this.#export(state, {
        format: format.select.value,
        frames: one ? [this.frame()] : null,
        surface: holds("surface"),
        tracked,
        snap: !ends.field.hidden && ends.select.value === "meshes",
        ...(timed && this.pace.request),
        ...(carries.includes("picture") && { picture: this.picture.request }),
        ...(!colours.field.hidden && colours.select.value && { texture: Number(colours.select.value) }),
        units: units.select.value,
        fields: fields.field.hidden || !fields.select.value ? [] : [fields.select.value],
      });
    };
    fill(
      this.exports,
      h("h3", null, "Export"),
      h(
        "form",
        { class: "row export-form", on: { submit } },
        format.field,
        content.field,
        frames.field,
        fields.field,
        units.field,
        ends.field,
        colours.field,
        this.picture.element,
        h("button", { class: "primary" }, "Export"),
      ),
      explain,
      made,
    );
    reflect();
  }

  async #export(state, wanted) {
    const bar = h("progress", { max: 1, value: 0, "aria-label": "Progress of the export" });
    const words = h("p", { class: "small" }, "Starting the export.");
    const tell = (...content) => fill(state, ...content).scrollIntoView({ block: "nearest" });
    tell(words, bar);
    try {
      let made = await post(`/jobs/${this.jobId}/exports`, wanted, { signal: this.signal });
      const path = `/jobs/${this.jobId}/exports/${made.id}`;
      while (made.state === "running") {
        bar.value = made.progress ?? 0;
        words.textContent = `The export is in progress, ${percent(made.progress ?? 0)}.`;
        await pause(ASK_MILLISECONDS, this.signal);
        made = await get(path, { signal: this.signal }).catch((error) => {
          if (!passes(error)) throw error;
          return made;
        });
      }
      if (made.state === "failed") throw new Problem({ detail: made.problem?.cause, ...made.problem });
      tell(
        h("p", { class: "small" }, "The export is ready. "),
        h(
          "div",
          { class: "row" },
          this.#file(`Save ${made.file_name}, ${bytes(made.size)}`, `${path}/file`, () => made.file_name),
        ),
      );
    } catch (error) {
      if (!this.signal.aborted) tell(problemNotice(error));
    }
  }

  #fault(error) {
    if (this.signal.aborted) return;
    if (!(error instanceof Problem)) throw error;
    fill(this.trouble, problemNotice(error));
  }
}
