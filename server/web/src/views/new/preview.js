/** The particles of a shape before they move. */

import { particles } from "../../api.js";
import { fill, h } from "../../dom.js";
import { plural } from "../../format.js";
import { part } from "../../part.js";
import { problemNotice } from "../../problem_notice.js";
import { bindKeys, cameraKeys } from "../../viewer/keys.js";
import { under } from "../../viewer/landmarks.js";

const PATIENCE = 250; // [ms] of quiet before particles are asked for
const CLICK = 4; // [px] that a pointer may move between down and up

const NOTHING = { message: "", turning: "", up: "y" };

/** A small 3D view of the particles that a shape becomes, how many, and what is odd about them. */
export class Preview {
  /**
   * @param {string} label
   * @param {AbortSignal} signal
   * @param {(about: {message: string, turning: string, up: string}) => void} placed hears what is done to
   *   both shapes unasked, in sentences or "", and which axis points upwards
   */
  constructor(label, signal, placed) {
    Object.assign(this, { label, signal, placed });
    this.scene = h("div", { class: "scene preview", tabindex: "0", role: "application", "aria-label": label });
    this.count = h("p", { class: "count small quiet", role: "status" });
    this.warnings = h("div", { class: "stack" });
    this.asking = new AbortController();
    this.told = NOTHING;
    this.marked = "[]";
    this.listening = new Set();
    const steer = (move) => this.viewer?.steer(move);
    const keys = {
      ...cameraKeys(steer),
      ArrowLeft: () => steer({ turn: [1, 0] }),
      ArrowRight: () => steer({ turn: [-1, 0] }),
      ArrowUp: () => steer({ turn: [0, 1] }),
      ArrowDown: () => steer({ turn: [0, -1] }),
      Home: () => this.viewer?.reset(),
      0: () => this.viewer?.reset(),
    };
    bindKeys(keys, { signal, element: this.scene });
    this.takeClicks();
    signal.addEventListener("abort", () => {
      this.asking.abort();
      this.viewer?.dispose();
    });
  }

  /**
   * Show the particles of a shape, and until they are there nothing.
   *
   * @param {object} shape
   * @param {object} query how to fill it, as the service takes it
   */
  show(shape, query) {
    const wanted = JSON.stringify([shape, query]);
    if (wanted === this.wanted) return this.placed(this.told);
    const { placement, ...unposed } = query;
    const filled = JSON.stringify([shape, unposed]);
    this.moves = filled === this.filled && !this.scene.classList.contains("empty");
    this.filled = filled;
    if (this.moves) this.forget(); // what is shown stays until it is shown elsewhere
    else this.clear();
    this.wanted = wanted;
    this.scene.setAttribute("aria-busy", "true");
    fill(this.count, "Filling the shape with particles");
    const { signal } = this.asking;
    this.timer = setTimeout(() => this.ask(shape, query, signal), PATIENCE);
  }

  /** Show nothing, at once. */
  clear() {
    this.forget();
    this.empty();
  }

  empty() {
    this.toUser = null;
    this.scene.classList.add("empty");
    this.tell();
  }

  forget() {
    this.wanted = null;
    this.told = NOTHING;
    this.asking.abort();
    this.asking = new AbortController();
    clearTimeout(this.timer);
    this.scene.removeAttribute("aria-busy");
    fill(this.count);
    fill(this.warnings);
  }

  /** Call something now and whenever other particles are shown, or none. */
  listen(heard) {
    this.listening.add(heard);
    heard();
  }

  tell() {
    for (const heard of this.listening) heard();
  }

  /** @param {((at: number[]) => void) | null} picked hears clicks on particles [the shape's own coordinates]. */
  pick(picked) {
    this.picked = picked;
    this.scene.classList.toggle("picking", Boolean(picked));
  }

  /** @param {Array<{at: number[], index: number}>} marks dots at points [the shape's own coordinates]. */
  mark(marks) {
    const toGrid = this.toUser && inverse(this.toUser);
    const shown = toGrid ? marks.map(({ at, index }) => ({ at: under(toGrid, at), index })) : [];
    if (!this.viewer || JSON.stringify(shown) === this.marked) return; // drawing takes time
    this.marked = JSON.stringify(shown);
    this.viewer.setMarks(shown);
  }

  takeClicks() {
    let down = null;
    const options = { signal: this.signal, capture: true };
    this.scene.addEventListener("pointerdown", ({ clientX, clientY }) => (down = [clientX, clientY]), options);
    this.scene.addEventListener(
      "pointerup",
      ({ clientX, clientY }) => {
        if (!this.picked || !down || Math.hypot(clientX - down[0], clientY - down[1]) > CLICK) return;
        const at = this.toUser && this.viewer?.pick(clientX, clientY);
        if (at) this.picked(under(this.toUser, at));
      },
      options,
    );
  }

  async ask(shape, query, signal) {
    try {
      const { positions, count, headers } = await particles(shape, { query, signal });
      fill(this.count, plural(count, "particle"));
      const warnings = JSON.parse(headers.get("Morph-Warnings") ?? "[]");
      fill(this.warnings, warnings.map((text) => h("p", { class: "notice warn" }, text)));
      this.told = {
        message: headers.get("Morph-Placement") ?? "",
        turning: headers.get("Morph-Turning") ?? "",
        up: headers.get("Morph-Up") ?? "y",
      };
      this.placed(this.told);
      this.toUser = JSON.parse(headers.get("Morph-To-User"));
      await this.draw(positions, signal).catch((error) => this.undrawable(error));
    } catch (error) {
      if (signal.aborted || this.signal.aborted) return;
      if (error.name !== "Problem") throw error;
      this.empty();
      fill(this.count);
      fill(this.warnings, problemNotice(error));
    } finally {
      if (!signal.aborted) this.scene.removeAttribute("aria-busy");
    }
  }

  undrawable(error) {
    if (this.signal.aborted) return;
    if (error.name === "Problem") return this.warnings.append(problemNotice(error));
    console.warn("no 3D view", error);
    this.warnings.append(h("p", { class: "quiet small" }, "This browser does not support 3D graphics."));
  }

  async draw(positions, signal) {
    if (!this.viewer) {
      const { Viewer } = await part(() => import("../../viewer/viewer.js"));
      if (this.signal.aborted || signal.aborted) return;
      this.viewer ??= new Viewer(this.scene, {
        reducedMotion: matchMedia("(prefers-reduced-motion: reduce)").matches,
      });
    }
    const { view } = this.viewer;
    this.viewer.setUp(this.told.up);
    this.viewer.canvas.setAttribute("aria-label", this.label);
    this.viewer.setFrame(0, positions);
    if (this.moves) this.viewer.view = view; // so that one sees it move
    else this.viewer.reset();
    this.scene.classList.remove("empty");
    this.tell();
  }
}

/** The way back of a map that turns, scales and moves. */
function inverse(matrix) {
  const rows = matrix.slice(0, 3);
  const square = rows[0].slice(0, 3).reduce((sum, one) => sum + one * one, 0); // of the scale
  const back = [0, 1, 2].map((i) => rows.map((row) => row[i] / square));
  const offset = rows.map((row) => row[3]);
  return back.map((row) => [...row, -row.reduce((sum, one, i) => sum + one * offset[i], 0)]);
}
