/** The particles of a shape before they move. */

import { points } from "../../api.js";
import { fill, h } from "../../dom.js";
import { plural } from "../../format.js";
import { problemNotice } from "../../problem_notice.js";
import { upright } from "../../viewer/display.js";
import { bindKeys, cameraKeys } from "../../viewer/keys.js";

const PATIENCE = 250; // [ms] of quiet before particles are asked for

/** A small 3D view of the particles that a shape becomes, how many, and what is odd about them. */
export class Preview {
  /**
   * @param {string} label
   * @param {AbortSignal} signal
   * @param {(message: string) => void} placed hears what the fit does to both shapes, or ""
   */
  constructor(label, signal, placed) {
    Object.assign(this, { label, signal, placed });
    this.scene = h("div", { class: "scene preview", tabindex: "0", role: "application", "aria-label": label });
    this.count = h("p", { class: "count small quiet", role: "status" });
    this.warnings = h("div", { class: "stack" });
    this.asking = new AbortController();
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
    if (wanted === this.wanted) return this.placed(this.message);
    this.clear();
    this.wanted = wanted;
    this.scene.setAttribute("aria-busy", "true");
    fill(this.count, "Filling the shape with particles");
    const { signal } = this.asking;
    this.timer = setTimeout(() => this.ask(shape, query, signal), PATIENCE);
  }

  /** Show nothing, at once. */
  clear() {
    this.wanted = null;
    this.message = ""; // what the fit does
    this.asking.abort();
    this.asking = new AbortController();
    clearTimeout(this.timer);
    this.scene.removeAttribute("aria-busy");
    this.scene.classList.add("empty");
    fill(this.count);
    fill(this.warnings);
  }

  async ask(shape, query, signal) {
    const path = shape.mesh
      ? `/meshes/${shape.mesh}/particles`
      : `/shapes/${encodeURIComponent(shape.shape)}/particles`;
    try {
      const { positions, count, headers } = await points(path, { query, signal });
      fill(this.count, plural(count, "particle"));
      const warnings = JSON.parse(headers.get("Morph-Warnings") ?? "[]");
      fill(this.warnings, warnings.map((text) => h("p", { class: "notice warn" }, text)));
      this.message = headers.get("Morph-Placement") ?? "";
      this.placed(this.message);
      await this.draw(positions, signal).catch((error) => this.undrawable(error));
    } catch (error) {
      if (signal.aborted || this.signal.aborted) return;
      if (error.name !== "Problem") throw error;
      fill(this.count);
      fill(this.warnings, problemNotice(error));
    } finally {
      if (!signal.aborted) this.scene.removeAttribute("aria-busy");
    }
  }

  undrawable(error) {
    if (this.signal.aborted) return;
    console.warn("no 3D view", error);
    this.warnings.append(h("p", { class: "quiet small" }, "This browser does not show 3D graphics."));
  }

  async draw(positions, signal) {
    if (!this.viewer) {
      const { Viewer } = await import("../../viewer/viewer.js");
      if (this.signal.aborted || signal.aborted) return;
      this.viewer ??= new Viewer(this.scene, {
        reducedMotion: matchMedia("(prefers-reduced-motion: reduce)").matches,
      });
    }
    this.viewer.setUp(upright());
    this.viewer.canvas.setAttribute("aria-label", this.label);
    this.viewer.setFrame(0, positions);
    this.scene.classList.remove("empty");
  }
}
