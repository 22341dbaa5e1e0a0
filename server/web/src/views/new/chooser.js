/** Where the particles come from, or what they become: a mesh of the user's, a shape or a text. */

import { get, upload } from "../../api.js";
import { fill, h } from "../../dom.js";
import { TEXT, count, plural } from "../../format.js";
import { problemNotice } from "../../problem_notice.js";
import { droppedFiles, packed, pickedFiles } from "./pack.js";
import { Pose } from "./pose.js";
import { Preview } from "./preview.js";

const ACCEPTED = ".obj,.ply,.stl,.off,.glb,.gltf,.zip,.mtl,.bin,.png,.jpg,.jpeg,.webp";
const LONGEST_TEXT = 60; // characters
const EARLIER = 50;

/** The choice of one shape, with what the service sees in it. */
export class Chooser {
  /**
   * @param {string} role "source", "target", or another word that no other chooser has
   * @param {string} label what it is to the user
   * @param {Array<{name: string}>} shapes that need no file
   * @param {object} heard
   * @param {(shape: object) => void} heard.changed hears {shape} or {mesh}
   * @param {() => void} heard.unsettled nothing is chosen until `changed`
   * @param {(about: object) => void} heard.placed hears what is done to both shapes unasked, see Preview
   * @param {(changes: object) => void} [heard.posed] hears settings of its pose; without, it has none
   * @param {AbortSignal} signal
   * @param {string} [noun] what it is in a sentence
   */
  constructor(role, label, shapes, { changed, unsettled, placed, posed }, signal, noun = role) {
    Object.assign(this, { role, label, changed, unsettled, signal, noun });
    this.preview = new Preview(`Particles of the ${noun}`, signal, placed);
    this.pose = posed && new Pose(role, this.preview, posed);
    this.trouble = h("div");
    this.report = h("div");
    this.panels = {
      file: this.filePanel(),
      shape: this.shapePanel(shapes.filter(({ name }) => !name.startsWith(TEXT))),
      text: this.textPanel(),
    };
    this.kinds = Object.fromEntries(
      [
        ["file", "Mesh file"],
        ["shape", "Built-in"],
        ["text", "Text"],
      ].map(([kind, text]) => [kind, this.kindButton(kind, text)]),
    );
    this.element = h(
      "section",
      { class: "panel stack chooser", "aria-label": label },
      h(
        "fieldset",
        { class: "stack" },
        h("legend", null, h("h2", null, label)),
        h("div", { class: "segments" }, Object.values(this.kinds).map(({ element }) => element)),
      ),
      ...Object.values(this.panels),
      this.trouble,
      h("div", { class: "preview-frame" }, this.preview.scene),
      this.preview.count,
      this.report,
      this.preview.warnings,
      this.pose?.upright,
      this.pose?.element,
    );
    this.takeDrops();
  }

  /**
   * Show a shape, and its particles as they would be sampled.
   *
   * @param {object} shape the choice, which is not shown while another one is being made
   * @param {object} sampling how to fill it
   * @param {object} other the other end of the morph
   * @param {object} [pose] how it is turned, scaled and moved
   */
  show(shape, sampling, other, pose) {
    if (this.missing()) return;
    const kind = shape.mesh ? "file" : shape.shape.startsWith(TEXT) ? "text" : "shape";
    const address = shape.mesh ?? shape.shape;
    Object.assign(this, { kind, shape, posed: pose });
    if (address !== this.address) {
      this.address = address;
      this.choose(kind);
      fill(this.report);
      if (kind === "file") this.describe(shape.mesh);
      if (kind === "text" && document.activeElement !== this.word) {
        this.word.value = address.slice(TEXT.length);
      }
      for (const button of this.panels.shape.querySelectorAll("input")) {
        button.checked = button.value === address;
      }
    }
    this.showPose();
    // two built-in shapes as they are do not look at each other
    const end = this.role === "source" ? "target" : "source";
    const alone = !shape.mesh && !other.mesh && !sampling.placement;
    const beside = alone ? {} : { [end]: other.mesh ?? other.shape };
    this.preview.show(shape, { ...sampling, ...beside });
  }

  /** Nothing is chosen: show nothing of what was. */
  clear() {
    this.address = null;
    this.kind = null;
    fill(this.report);
    this.preview.clear();
    this.unsettled();
  }

  /** Take a choice, which is complete. */
  settle(shape) {
    this.taking = null;
    this.failed = false;
    this.uploading?.abort();
    this.uploading = null;
    fill(this.trouble);
    if ((shape.mesh ?? shape.shape) !== this.address) this.clear();
    this.kind = shape.mesh ? "file" : shape.shape.startsWith(TEXT) ? "text" : "shape";
    this.changed(shape);
  }

  /**
   * Take files that were dropped or picked: a mesh, and what belongs to it.
   *
   * @param {Array<{path: string, file: File}> | Promise} found
   */
  async takeAll(found) {
    if (found.length === 1) return this.take(found[0].file);
    this.uploading?.abort();
    this.choose("file");
    fill(this.trouble);
    this.clear();
    const taking = (this.taking = {}); // until anything else is chosen
    const file = await packed(await found);
    if (taking !== this.taking) return;
    if (file) return this.take(file);
    this.failed = true;
    fill(this.trouble, h("p", { class: "notice bad", role: "alert" }, "There are no files in this folder."));
  }

  /** Take the file of a mesh. */
  async take(file) {
    this.choose("file");
    fill(this.trouble);
    this.failed = false;
    this.earlier.value = "";
    this.clear();
    const bar = h("progress", { max: 1, value: 0, "aria-label": `Upload of ${file.name}` });
    const said = h("p", { class: "small", role: "status" }, `Uploading ${file.name}`);
    fill(this.sending, bar, said);
    this.uploading?.abort();
    const own = (this.uploading = new AbortController());
    const signal = AbortSignal.any([this.signal, own.signal]);
    try {
      const onProgress = (share) => {
        bar.value = share;
        if (share === 1) fill(said, `Reading ${file.name}`);
      };
      const query = { name: file.name };
      const mesh = await upload("/meshes", file, { query, signal, onProgress });
      this.known.set(mesh.id, mesh);
      this.listEarlier();
      if (!signal.aborted) this.settle({ mesh: mesh.id });
    } catch (error) {
      if (signal.aborted) return;
      if (error.name !== "Problem") throw error;
      this.failed = true;
      fill(this.trouble, problemNotice(error));
    } finally {
      if (own === this.uploading || !this.uploading) {
        this.uploading = null;
        fill(this.sending);
        this.picker.value = "";
      }
    }
  }

  /** Whether the choice is not finished; then it says so, where it can be finished. */
  complains() {
    const [missing, input] = this.missing() ?? [];
    if (!missing) return false;
    fill(this.trouble, h("p", { class: "notice bad", role: "alert" }, missing));
    input.focus();
    return true;
  }

  missing() {
    if (this.uploading) return ["The file is still being uploaded.", this.picker];
    if (this.failed) return ["Choose another mesh file, or another kind of shape.", this.picker];
    if (this.kinds.file.input.checked && this.kind !== "file") {
      return ["Choose a mesh file, or another kind of shape.", this.picker];
    }
    if (this.kinds.text.input.checked && !(this.kind === "text" && this.word.checkValidity())) {
      return ["Enter a text, or choose another kind of shape.", this.word];
    }
    return null;
  }

  choose(kind) {
    this.taking = null;
    for (const [name, panel] of Object.entries(this.panels)) panel.hidden = name !== kind;
    this.kinds[kind].input.checked = true;
  }

  kindButton(kind, text) {
    const change = () => {
      fill(this.trouble);
      this.uploading?.abort();
      this.failed = false;
      this.choose(kind);
      const chosen = this.panels.shape.querySelector("input:checked");
      if (kind === "shape") this.settle({ shape: chosen?.value ?? this.shapes[0] });
      else if (kind === "file" && this.earlier.value) this.settle({ mesh: this.earlier.value });
      else if (kind === "text" && this.word.checkValidity()) this.settle({ shape: TEXT + this.word.value });
      else this.clear();
    };
    const input = h("input", { type: "radio", name: `${this.role}-kind`, value: kind, on: { change } });
    return { input, element: h("label", { class: "segment" }, input, h("span", null, text)) };
  }

  filePanel() {
    this.known = new Map();
    this.sending = h("div", { class: "stack" });
    this.picker = h("input", {
      type: "file",
      id: `${this.role}-file`,
      accept: ACCEPTED,
      class: "visually-hidden",
      "aria-label": `Mesh file of the ${this.noun}`,
      multiple: true,
      on: { change: ({ target }) => target.files[0] && this.takeAll(pickedFiles(target.files)) },
    });
    const change = (event) => {
      if (event.target.value) this.settle({ mesh: event.target.value });
      else this.clear();
    };
    this.earlier = h("select", { id: `${this.role}-earlier`, on: { change } });
    this.earlierField = h(
      "div",
      { class: "field", hidden: true },
      h("label", { for: `${this.role}-earlier` }, "Or a mesh uploaded before"),
      this.earlier,
    );
    get("/meshes", { query: { limit: EARLIER }, signal: this.signal }).then(
      ({ items }) => {
        for (const mesh of items) if (!this.known.has(mesh.id)) this.known.set(mesh.id, mesh);
        this.listEarlier();
      },
      () => {}, // without the list one can still send a file
    );
    return h(
      "div",
      { class: "stack" },
      h(
        "div",
        null,
        this.picker,
        h(
          "label",
          { class: "drop", for: `${this.role}-file` },
          h("span", null, "Drop a mesh here, or ", h("span", { class: "as-link" }, "choose a file")),
          h("span", { class: "quiet small" }, "OBJ, PLY, STL, OFF, GLB or glTF; with textures: all files together, or a ZIP"),
        ),
      ),
      this.sending,
      this.earlierField,
    );
  }

  listEarlier() {
    const chosen = this.known.has(this.address) ? this.address : "";
    fill(
      this.earlier,
      h("option", { value: "" }, "Choose"),
      [...this.known.values()].map((mesh) => h("option", { value: mesh.id }, mesh.name)),
    );
    this.earlier.value = chosen;
    this.earlierField.hidden = this.known.size === 0;
  }

  shapePanel(shapes) {
    this.shapes = shapes.map(({ name }) => name);
    const change = (event) => this.settle({ shape: event.target.value });
    return h(
      "fieldset",
      null,
      h("legend", { class: "visually-hidden" }, `Built-in shape of the ${this.noun}`),
      h(
        "div",
        { class: "row" },
        this.shapes.map((name) =>
          h(
            "label",
            { class: "choice pill" },
            h("input", { type: "radio", name: `${this.role}-shape`, value: name, on: { change } }),
            name,
          ),
        ),
      ),
    );
  }

  textPanel() {
    const trouble = h("p", { class: "fault", role: "alert", id: `${this.role}-text-fault` });
    const change = () => {
      const fine = this.word.checkValidity();
      fill(trouble, fine ? "" : "Enter at least one character.");
      this.word.toggleAttribute("aria-invalid", false);
      if (!fine) this.word.setAttribute("aria-invalid", "true");
    };
    const typed = () => {
      if (this.word.checkValidity()) this.settle({ shape: TEXT + this.word.value });
      else this.clear();
    };
    this.word = h("input", {
      id: `${this.role}-text`,
      type: "text",
      required: true,
      pattern: ".*\\S.*",
      maxlength: LONGEST_TEXT,
      autocomplete: "off",
      spellcheck: "false",
      "aria-describedby": `${this.role}-text-hint ${this.role}-text-fault`,
      on: { input: typed, change },
    });
    return h(
      "div",
      { class: "field" },
      h("label", { for: `${this.role}-text` }, "Text"),
      this.word,
      h("p", { class: "hint", id: `${this.role}-text-hint` }, "Letters are extruded, one word per line. Any script with an installed font works."),
      trouble,
    );
  }

  async describe(id) {
    try {
      const mesh = this.known.get(id) ?? (await get(`/meshes/${id}`, { signal: this.signal }));
      this.known.set(id, mesh);
      this.listEarlier();
      if (this.address === id) fill(this.report, report(mesh));
      if (this.address === id) this.showPose();
    } catch (error) {
      if (this.signal.aborted) return;
      if (error.name !== "Problem") throw error;
      fill(this.trouble, problemNotice(error));
    }
  }

  showPose() {
    const mesh = this.shape.mesh && this.known.get(this.shape.mesh);
    if (this.posed) this.pose?.show(this.posed, this.upwards(), Boolean(mesh && !mesh.report.up));
  }

  /** What the file tells about the upward axis. */
  upwards() {
    if (!this.shape.mesh) return "y";
    const mesh = this.known.get(this.shape.mesh);
    if (!mesh) return "";
    const { up } = mesh.report;
    const kind = mesh.name.split(".").at(-1).toLowerCase();
    if (!up) return "unknown, not rotated";
    if (["glb", "gltf"].includes(kind)) return `${up}, as defined by glTF`;
    if (kind === "zip") return up;
    return kind === "stl" ? `${up}, as usual for STL` : `${up}, from its flat base`;
  }

  takeDrops() {
    const over = (on) => (event) => {
      if (!event.dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      this.element.classList.toggle("over", on);
    };
    this.element.addEventListener("dragover", over(true));
    this.element.addEventListener("dragleave", over(false));
    this.element.addEventListener("drop", (event) => {
      over(false)(event);
      if (event.dataTransfer?.files[0]) this.takeAll(droppedFiles(event.dataTransfer));
    });
  }
}

function report({ name, report: seen }) {
  const parts = seen.component_count > 1 ? `, ${plural(seen.component_count, "part")}` : "";
  const coloured = (seen.colors ?? "none") === "none" ? "" : ", coloured";
  return h(
    "p",
    { class: "small" },
    h("strong", null, name),
    `: ${count(seen.face_count)} triangles${parts}, ${seen.watertight ? "closed" : "open"}${coloured}`,
  );
}
