/** One job in the viewer: its frames, colours, target and surface, with words that tell the same. */
import { colours, particles, pause, points } from "../api.js";
import { fill, h } from "../dom.js";
import { number, percent } from "../format.js";
import { part } from "../part.js";
import { problemNotice } from "../problem_notice.js";
import { COLOURS, decisive, range, values } from "./colors.js";
import { Frames } from "./frames.js";
import { followed } from "./landmarks.js";
import { Legend } from "./legend.js";
import { nearest } from "./nearest.js";
import { OwnColors } from "./own_colors.js";
import { Surfaces } from "./surfaces.js";
import { travel } from "./travel.js";

const FIELDS_HELD = 40e6; // bytes
const PATIENCE_MILLISECONDS = 400;
const HURRY_MILLISECONDS = 150;
const LESS_MOTION = "(prefers-reduced-motion: reduce)";
const HELP =
  "Drag to turn, right button or two fingers to move, wheel to zoom. " +
  "Keys: 4, 6, 8 and 2 turn, with Shift they move, + and − zoom; question mark lists all keys.";

/** A figure with the 3D view of a job; all of its methods may be called before it is ready. */
export class Panel {
  #turn = 0;
  #viewer = null;
  #ready;
  #opened;
  #fields = new Map();
  #playing = false;
  #grows = false;
  #asked = new AbortController();
  #shapeAsked = false;
  #sourceAsked = false;
  #ends = null; // positions of the source and of each target, until they are in the viewer
  #endsAsked = false;
  #begins = false; // whether what the job begins with is shown
  #rangeOf = "";
  #measured = Infinity; // frames that were known then
  #own = null; // promise of the colours of the shapes, asked for when so many frames were known:
  #ownOf = 0;
  #ownShown = null;
  #targetShown = null;
  #landmarks = [];
  #followed = null; // the particle of each
  #targets = new Map(); // by how they are shown and the leg that leads to them
  #mesh = null; // the surface that is shown, and its vertices on their way
  #moved = new Float32Array(0);

  /**
   * @param {string} jobId
   * @param {object} options
   * @param {AbortSignal} options.signal ends everything.
   * @param {object} options.display see display.js.
   * @param {(view: object) => void} [options.onView] hears how the user moves the camera.
   * @param {(names: object) => void} [options.onQuality] hears how finely is drawn, see viewer.js.
   * @param {() => void} [options.onOwn] hears that the shapes have colours of their own.
   * @param {() => void} [options.onArrival] hears that a frame has come.
   * @param {() => void} [options.onEnds] hears that the camera knows what is to be in sight in every frame.
   * @param {() => Promise<object | null>} [options.sharedRange] the range of several jobs together.
   * @param {number} [options.share] of the memory for frames and surfaces, where several panels share it.
   */
  constructor(
    jobId,
    { signal, display, onView, onQuality, onOwn = () => {}, onArrival = () => {}, onEnds = () => {}, sharedRange = null, share = 1 },
  ) {
    this.jobId = jobId;
    this.signal = signal;
    this.display = { ...display };
    this.sharedRange = sharedRange;
    this.onOwn = onOwn;
    this.onEnds = onEnds;
    this.metrics = () => null;
    this.total = 0;
    this.legs = 1;
    this.index = -1;
    this.surfaces = new Surfaces(jobId, signal, share);
    this.surfaces.snapped = display.ends === "meshes";
    this.frames = new Frames(jobId, {
      signal,
      share,
      onArrival: (index) => {
        if (this.#changesColours(index)) this.#recolour();
        onArrival(index);
      },
    });
    this.scene = h("div", {
      class: "scene",
      tabindex: 0,
      role: "application",
      "aria-roledescription": "3D view",
      "aria-label": "3D view of the particles",
    });
    this.help = h("p", { class: "visually-hidden", id: `help-${jobId}` }, HELP);
    this.scene.setAttribute("aria-describedby", this.help.id);
    this.note = h("div", { class: "scene-note small", hidden: true });
    this.surfaceWords = h("p", { class: "quiet small surface-words" }); // how good it is, for where there is room
    this.legend = new Legend();
    this.caption = h("figcaption", { class: "small quiet" }, "No frame is finished yet.");
    this.element = h(
      "figure",
      { class: "view" },
      h("div", { class: "scene-frame" }, this.scene),
      h("div", { class: "under" }, this.note, this.legend.element, this.caption),
      this.help,
    );
    this.#ready = new Promise((resolve) => (this.#opened = resolve));
    Object.assign(this, { onView, onQuality });
    signal.addEventListener("abort", () => this.#viewer?.dispose(), { once: true });
  }

  /** Make the 3D view, which takes a moment: ask for what it is to show before. */
  open() {
    this.#opened(this.#open());
  }

  /** @returns {Promise<import("./viewer.js").Viewer | null>} null where 3D cannot be shown. */
  get viewer() {
    return this.#ready;
  }

  /** @param {object} config of the job, which tells how far apart its particles are. */
  async setConfig({ grid, sampling }) {
    (await this.#ready)?.setSpacing(grid.dx / sampling.points_per_cell_edge);
  }

  /**
   * Show dots that go with the matter of landmarks.
   *
   * @param {object[]} landmarks see landmarks.js.
   * @param {(positions: Float32Array, particles: number[], index: number) => void} onMove hears where their
   *   particles are, and in which frame; -1 in the source.
   */
  setLandmarks(landmarks, onMove) {
    this.#landmarks = landmarks;
    this.onMove = onMove;
    if (this.index >= 0 || this.source) this.#showLandmarks();
  }

  async #showLandmarks() {
    if (!this.#landmarks.length) return;
    const { index } = this;
    const { source } = await this.#given("displacement");
    if (!source || index !== this.index) return;
    this.#followed ??= followed(this.#landmarks, source);
    const positions = index < 0 ? source : this.frames.positions(index);
    if (!positions) return;
    this.#viewer?.setMarks(
      this.#landmarks.map((landmark, i) => {
        const first = 3 * this.#followed[i];
        return { at: [...positions.slice(first, first + 3)], index: landmark.index };
      }),
    );
    this.onMove(positions, this.#followed, index);
  }

  /** Forget all frames: the job began anew. */
  clear() {
    this.frames.clear();
    this.#fields.clear();
    this.surfaces.clear();
    this.source = undefined;
    this.#followed = null;
    this.#shapeAsked = this.#sourceAsked = this.#begins = false;
    this.#rangeOf = "";
    this.#own = this.#ownShown = null;
    this.index = -1;
    this.#turn += 1;
    this.#asked.abort();
    this.#asked = new AbortController();
    this.#viewer?.clear();
    this.legend.show(null);
    this.#say("");
    this.#tellOf(null);
  }

  /** Show a frame once it is here; a later call overtakes an earlier one. While playing, none waits for surfaces. */
  async show(index, { playing = false } = {}) {
    const turn = ++this.#turn;
    this.#playing = playing;
    this.#asked.abort();
    this.#asked = new AbortController();
    const viewer = await this.#ready;
    if (viewer) this.#askForEnds(viewer);
    if (!(await this.#arrival(index, turn)) || turn !== this.#turn) return;
    this.index = index;
    if (viewer) this.#showEnds(viewer);
    viewer?.setFrame(index, this.frames.positions(index));
    this.describe();
    this.#showLandmarks();
    if (viewer && this.#targetShown !== this.#targetWanted()) this.#showTarget(viewer);
    if (viewer) await this.#paint(viewer, turn);
  }

  /** Have all shapes from the source to the target in sight in every frame, once they are here. */
  async #askForEnds(viewer) {
    if (this.#endsAsked) return;
    this.#endsAsked = true;
    const { signal, legs } = this;
    const ask = (end, query) => points(`/jobs/${this.jobId}/${end}`, { query, signal });
    const targets = Array.from({ length: legs }, (_, leg) => ask("target", legs > 1 ? { leg } : {}));
    try {
      const found = await Promise.all([ask("source", {}), ...targets]);
      this.#ends = found.map(({ positions }) => positions);
    } catch (error) {
      if (!signal.aborted && error.name !== "Problem") throw error; // the frames will do
    }
    if (this.index >= 0) this.#showEnds(viewer);
  }

  /** Turn to all shapes, if they are here: with a frame, as what is seen before it stays where it is. */
  #showEnds(viewer) {
    if (!this.#ends) return;
    viewer.setEnds(this.#ends);
    this.#ends = null;
    this.onEnds();
  }

  /** Wait for a frame, and say why it takes a while. */
  async #arrival(index, turn) {
    const tell = () => {
      if (turn !== this.#turn) return clearInterval(timer);
      const trouble = this.frames.trouble(index);
      this.#say(trouble ? `The frame is not available: ${trouble} It is asked for again.` : "Getting the frame…");
    };
    const timer = this.#viewer && setInterval(tell, PATIENCE_MILLISECONDS);
    try {
      return await this.frames.wait(index);
    } finally {
      clearInterval(timer);
    }
  }

  /** Wait until motion shows what is seen at rest: until the surfaces of all frames are here, if they are wanted. */
  async ready() {
    if (this.display.shape === "surface" && !this.#waits && (await this.#ready)) await this.#fillSurfaces();
  }

  /** Whether the job still computes; it is spared the work that surfaces are, until somebody asks for one. */
  get grows() {
    return this.#grows;
  }

  set grows(grows) {
    const done = this.#grows && !grows;
    this.#grows = grows;
    if (!done) return;
    this.#own = null; // now that the end is known, to which colours lead
    if (this.#ownShown || this.surfaces.snap) this.surfaces.clear();
    this.#recolour();
  }

  /** Show the matter on its way from the frame shown to the next one, at a share of it. */
  between(share) {
    if (!this.#viewer || matchMedia(LESS_MOTION).matches) return;
    if (this.#viewer.kind === "surface") return this.#moveSurface(share);
    const positions = this.frames.between(this.index, share);
    if (!positions) return;
    this.#viewer.setFrame(this.index, positions);
    if (this.#ownShown) this.#viewer.setParticleLight(this.#ownShown.after(this.index + 1 + share));
  }

  #moveSurface(share) {
    const { vertices } = this.#mesh;
    const way = this.#travel(this.index, this.#mesh);
    if (!way) return;
    if (this.#moved.length !== vertices.length) this.#moved = new Float32Array(vertices.length);
    for (let i = 0; i < vertices.length; i++) this.#moved[i] = vertices[i] + share * way[i];
    this.#viewer.moveSurface(this.#moved);
  }

  /** How far each vertex of a frame's surface goes until the next frame, if that is here. */
  #travel(index, mesh) {
    if (!mesh.travel) {
      const to = this.frames.between(index, 1)?.slice();
      if (!to) return null;
      const from = this.frames.positions(index);
      mesh.travel = travel(mesh.faces, nearest(from, mesh.vertices, 1.5 * this.#viewer.spacing), from, to);
    }
    return mesh.travel;
  }

  /**
   * Show the shape that a job begins with, before the job itself has any particles.
   *
   * @param {object} job
   * @param {object} config of it, which tells how the shape is filled.
   */
  async showShape({ source, target }, { sampling, placement }) {
    if (this.#shapeAsked || this.#sourceAsked || this.frames.known) return;
    this.#shapeAsked = true;
    const turn = this.#turn;
    const { points_per_cell_edge, fit } = sampling;
    const query = { points_per_cell_edge, fit, placement: JSON.stringify(placement), target: target.mesh ?? target.shape };
    try {
      const { positions } = await particles(source, { query, signal: this.signal });
      if (!this.source) await this.#showBeginning(positions, turn);
    } catch (error) {
      if (!this.signal.aborted && error.name !== "Problem") throw error; // the source will do
    }
  }

  /** @returns {Promise<import("./viewer.js").Viewer | null>} null where it is too late for it. */
  async #showBeginning(positions, turn) {
    const viewer = await this.#ready;
    if (turn !== this.#turn || this.frames.known) return null;
    this.#begins = true;
    viewer?.setSurface(null);
    viewer?.setFrame(-1, positions);
    this.describe();
    return viewer;
  }

  /** Show the source until there is a frame, particle by particle. */
  async showSource() {
    if (this.#sourceAsked || this.frames.known) return;
    this.#sourceAsked = true;
    const turn = this.#turn;
    try {
      this.source ??= (await points(`/jobs/${this.jobId}/source`, { signal: this.signal })).positions;
    } catch {
      return; // the first frame will do
    }
    const viewer = await this.#showBeginning(this.source, turn);
    if (!viewer) return;
    this.#showLandmarks();
    const own = this.display.colour === "own" ? await this.#ownColours() : null;
    if (own && turn === this.#turn && !this.frames.known) viewer.setParticleLight(own.after(0));
  }

  /** Show the same frame in another way. */
  async setDisplay(display) {
    const before = this.display;
    this.display = { ...display };
    this.surfaces.snapped = display.ends === "meshes";
    const viewer = await this.#ready;
    if (!viewer) return;
    if (before.up !== display.up) viewer.setUp(display.up);
    if (before.look !== display.look) viewer.setLook(display.look);
    if (before.quality !== display.quality) viewer.setQuality(display.quality);
    if (before.focus !== display.focus) viewer.setFocus(display.focus);
    const { axis, offset } = display;
    viewer.setCut(axis === "none" ? null : { axis, offset });
    const turning = ["colour", "shape", "up", "look", "ends"].some((name) => before[name] !== display[name]);
    if (this.#targetShown !== this.#targetWanted()) await this.#showTarget(viewer);
    if (turning) await this.#recolour();
  }

  /** Say what is shown: briefly below it, and how good it is to those who do not see it. */
  describe() {
    const metrics = this.metrics(this.index);
    const frame = `Frame ${this.index + 1} of ${this.total || this.frames.known}`;
    const parts = [frame];
    if (metrics?.two_sided !== undefined) {
      parts.push(`Chamfer distance ${number(metrics.two_sided, 3)} dx`);
    }
    if (metrics?.coverage !== undefined) parts.push(`coverage ${percent(metrics.coverage).replace(" ", "\u00a0")}`);
    const none = this.#begins ? "The source. No frame is finished yet." : "No frame is finished yet.";
    this.caption.textContent = this.index < 0 ? none : frame;
    this.scene.querySelector("canvas")?.setAttribute("aria-label", this.index < 0 ? none : `${parts.join(", ")}.`);
  }

  /** Compute the range of colours again, as when more frames are known. */
  async measure() {
    const { colour } = this.display;
    if (!(colour in COLOURS) || !this.frames.known) return null;
    return range(colour, this.frames, await this.#given());
  }

  /** Colour again, as when the shared range has changed. */
  recolour() {
    return this.#recolour();
  }

  /** Whether a frame that has come changes the range of colours, or the speed in the one shown. */
  #changesColours(index) {
    const { colour } = this.display;
    if (!(colour in COLOURS)) return false;
    if (colour === "speed" && index === this.index - 1) return true;
    if (COLOURS[colour].local) return decisive(colour, this.frames).includes(index);
    return !this.sharedRange && this.frames.known >= 2 * this.#measured; // few frames tell little
  }

  async #open() {
    try {
      const { Viewer } = await part(() => import("./viewer.js"));
      if (this.signal.aborted) return null;
      const reducedMotion = matchMedia(LESS_MOTION).matches;
      const { onView, onQuality } = this;
      this.#viewer = new Viewer(this.scene, { reducedMotion, onView, onQuality });
    } catch (error) {
      console.warn("no 3D view", error);
      const missing = "This browser does not support 3D graphics; numbers and downloads are below.";
      this.#say(error.name === "Problem" ? problemNotice(error) : missing);
      return null;
    }
    const { axis, offset, up, look, quality, focus } = this.display;
    this.#viewer.setUp(up);
    this.#viewer.setLook(look);
    this.#viewer.setQuality(quality);
    this.#viewer.setFocus(focus);
    this.#viewer.setCut(axis === "none" ? null : { axis, offset });
    this.#showTarget(this.#viewer);
    this.describe();
    return this.#viewer;
  }

  async #recolour() {
    const viewer = await this.#ready;
    this.#rangeOf = "";
    if (viewer && this.index >= 0) await this.#paint(viewer, this.#turn);
  }

  /** Colours and surface of the frame shown, as far as nothing newer is wanted; particles until it is there. */
  async #paint(viewer, turn) {
    const { shape } = this.display;
    const asked = ["shape", "look", "ends"].map((name) => [name, this.display[name]]);
    const others = () =>
      turn !== this.#turn || this.signal.aborted || asked.some(([name, value]) => value !== this.display[name]);
    const held = shape === "surface" ? this.#heldSurface() : null;
    viewer.setSurface((this.#mesh = held));
    this.#say(held ? "" : this.#absence());
    this.#tellOf(held);
    await this.#paintColours(viewer, held, others);
    if (others() || shape !== "surface" || held || this.#playing || this.#waits) return;
    try {
      await pause(HURRY_MILLISECONDS, this.#asked.signal); // who hurries through frames asks for none
      if (others()) return;
      const mesh = await this.#patiently("Computing the surface…", this.surfaces.get(this.index, this.#asked.signal));
      if (others()) return;
      viewer.setSurface((this.#mesh = mesh));
      this.#say("");
      this.#tellOf(mesh);
      await this.#paintColours(viewer, mesh, others);
    } catch (error) {
      if (!others() && error.name !== "AbortError") this.#say(`The surface is not available: ${error.message}`);
    }
  }

  /** Colour the particles, or the surface where there is one. */
  async #paintColours(viewer, mesh, others) {
    const { colour } = this.display;
    const set = (values, scale) => {
      if (mesh) viewer.setSurfaceColors(values, scale, values && this.#near(mesh));
      else viewer.setColors(values, scale);
      this.legend.show(values ? colour : null, scale);
    };
    this.#ownShown = null;
    if (colour === "own") {
      const own = await this.#ownColours();
      if (others() || colour !== this.display.colour) return;
      if (!own) return set(null);
      this.legend.show(null);
      this.#ownShown = own;
      if (mesh?.light) viewer.setSurfaceLight(mesh.light);
      else if (mesh) viewer.setSurfaceLight(own.after(this.index + 1), this.#near(mesh));
      else viewer.setParticleLight(own.after(this.index + 1));
      return;
    }
    if (!(colour in COLOURS)) return set(null);
    try {
      const [values, scale] = await this.#patiently("Computing the colours…", this.#coloured(colour));
      if (others() || colour !== this.display.colour) return;
      set(values, scale);
      this.#say(mesh ? "" : this.#absence());
    } catch (error) {
      if (others() || error.name === "AbortError") return;
      set(null);
      this.#say(`${COLOURS[colour].label} is not available: ${error.message}`);
    }
  }

  /**
   * Colours of the shapes. While the job computes, one of its last frames stands for its end, so that they are
   * asked for again when there are twice as many frames.
   *
   * @returns {Promise<OwnColors | null>} null where there are none.
   */
  #ownColours() {
    const known = Math.max(1, this.frames.known);
    if (this.#own && (!this.#grows || known < 2 * this.#ownOf)) return this.#own;
    this.#ownOf = known;
    const asked = colours(this.jobId, { signal: this.signal })
      .then((found) => {
        if (found) this.onOwn();
        return found && new OwnColors(found.bytes, found.reached);
      })
      .catch(() => {
        if (this.#own === asked) this.#own = null; // asked for again with the next frame
        return null;
      });
    this.#own = asked;
    return asked;
  }

  async #coloured(colour) {
    const scale = await this.#scale();
    return [scale && (await this.#values(colour, scale)), scale];
  }

  /** Wait for something, and say so if it takes a while. */
  async #patiently(text, promise) {
    const timer = setTimeout(() => this.#say(text), PATIENCE_MILLISECONDS);
    try {
      return await promise;
    } finally {
      clearTimeout(timer);
    }
  }

  async #scale() {
    const key = `${this.display.colour} ${this.display.up}`;
    if (this.#rangeOf !== key || !this.scale) {
      this.#fields.clear();
      this.#measured = Math.max(1, this.frames.known);
      this.scale = await (this.sharedRange ? this.sharedRange() : this.measure());
      this.#rangeOf = key;
    }
    return this.scale;
  }

  async #values(colour, scale) {
    const given = { ...(await this.#given()), range: scale };
    if (COLOURS[colour].local) return values(colour, this.frames, this.index, given);
    const { index } = this;
    const name = `${colour} ${index}`;
    if (!this.#fields.has(name)) {
      const found = await values(colour, this.frames, index, { ...given, signal: this.#asked.signal });
      if (found.byteLength * this.#fields.size > FIELDS_HELD) this.#fields.clear();
      this.#fields.set(name, found);
    }
    return this.#fields.get(name);
  }

  /** What colourings need besides the frame; where the source is unknown, frame 0 stands for it. */
  async #given(colour = this.display.colour) {
    const { up } = this.display;
    if (!this.source && ["height", "displacement", "speed"].includes(colour)) {
      this.asking ??= points(`/jobs/${this.jobId}/source`, { signal: this.signal })
        .then(({ positions }) => positions)
        .catch(async () => ((await this.frames.wait(0)) ? this.frames.positions(0).slice() : null));
      this.source = await this.asking;
      this.asking = undefined;
    }
    return { source: this.source ?? null, up };
  }

  /** Whether the surface has to wait until the job is done. */
  get #waits() {
    return this.grows && !this.display.asked;
  }

  /**
   * The surface of the frame shown, if it is here. In motion, only if those of all frames are, so that one and
   * the same thing moves.
   */
  #heldSurface() {
    const { surfaces, index, frames } = this;
    if (this.#playing && surfaces.count < frames.known) {
      if (!this.#waits) this.#fillSurfaces();
      return null;
    }
    return surfaces.held(index) ?? null;
  }

  #fillSurfaces() {
    return this.surfaces.fill(this.frames.known, (at, mesh) => this.#travel(at, mesh));
  }

  /** Why there are particles where a surface is wanted. */
  #absence() {
    if (this.display.shape !== "surface") return "";
    if (this.#waits) return "Particles only while the job is running; S shows the surface.";
    if (!this.#playing) return "";
    const { surfaces, frames } = this;
    if (surfaces.full) return "Particles in motion: the surfaces of all frames need too much memory. Pause to see the surface.";
    return `Particles until all surfaces are loaded: ${surfaces.count} of ${frames.known}.`;
  }

  /** The particle nearest to each vertex of the surface of the frame shown. */
  #near(mesh) {
    mesh.near ??= nearest(this.frames.positions(this.index), mesh.vertices, 3 * this.#viewer.spacing);
    return mesh.near;
  }

  /** @param {object} job whose frames are shown: how many there will be, and of how many legs. */
  plan({ progress, via = [] }) {
    this.total = progress.frames;
    this.legs = via.length + 1;
  }

  /** Which target is to be seen, and how: that of the leg of the frame shown. */
  #targetWanted() {
    const leg = Math.floor((this.index * this.legs) / this.total) || 0;
    const { target } = this.display;
    return target === "none" ? target : `${target} ${Math.min(Math.max(leg, 0), this.legs - 1)}`;
  }

  async #showTarget(viewer) {
    const wanted = this.#targetWanted();
    const [kind, leg] = wanted.split(" ");
    this.#targetShown = wanted;
    try {
      if (kind !== "none" && !this.#targets.has(wanted)) {
        const options = { query: this.legs > 1 ? { leg } : {}, signal: this.signal };
        const path = `/jobs/${this.jobId}/target`;
        const found =
          kind === "cloud"
            ? await points(path, options)
            : await (await import("./meshes.js")).mesh(`${path}/mesh`, options);
        this.#targets.set(wanted, found);
      }
      if (this.#targetShown !== wanted) return;
      viewer.setTarget(kind === "cloud" ? this.#targets.get(wanted) : null);
      viewer.setWireframe(kind === "wireframe" ? this.#targets.get(wanted) : null);
    } catch (error) {
      if (this.signal.aborted) return;
      if (this.index < 0) this.#targetShown = null; // it comes with the first frame
      else this.#say(`The target is not available: ${error.message}`);
    }
  }

  #say(text) {
    this.note.hidden = !text;
    fill(this.note, text);
  }

  #tellOf(mesh) {
    this.surfaceWords.textContent = mesh ? about(mesh, this.index) : "";
  }
}

function about({ headers }, index) {
  if (!headers.has("Morph-Deviation-Mean")) return "";
  const mean = Number(headers.get("Morph-Deviation-Mean"));
  const closed = headers.get("Morph-Watertight") === "true" ? "closed surface" : "surface with holes";
  return `Frame ${index + 1}: ${closed}, ${number(mean, 2)} dx from the target on average.`;
}
