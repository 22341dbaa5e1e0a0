/** The 3D view: particles or a surface, the target as a ghost, a cut. Draws on demand. */
import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  Color,
  DirectionalLight,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  NeutralToneMapping,
  Plane,
  Scene,
  Vector3,
  WebGLRenderer,
  WireframeGeometry,
} from "three";

import { backdrop } from "./backdrop.js";
import { lowest } from "./bounds.js";
import { CASTS, ContactShadow } from "./contact_shadow.js";
import { DepthOfField, POINTS } from "./depth_of_field.js";
import { FOCUS } from "./focus.js";
import { freshCanvas } from "./fresh_canvas.js";
import { LOOKS } from "./looks.js";
import { Marks } from "./marks.js";
import { BALL } from "./matcap.js";
import { roomLight } from "./materials.js";
import { Occlusion } from "./occlusion.js";
import { shades } from "./own_colors.js";
import { Particles } from "./particles.js";
import { LEVELS, Quality } from "./quality.js";
import { record } from "./recording.js";
import { spacing } from "./spacing.js";
import { Surface } from "./surface.js";
import { byParticle, byValue } from "./vertex_colors.js";
import { Viewpoint } from "./viewpoint.js";

const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const RADIUS = 0.62; // of the spacing: neighbours touch and holes still show
const GHOST_RADIUS = 0.22;
const SKETCHED = 10_000; // particles of a sketch
const REST_MILLISECONDS = 300; // without a change, which is longer than a frame at the slowest pace
const LAMPS = [
  [1.5, -0.7, 0.9, 0.5], // strength and place beside the camera: key
  [1, 0.8, 0.5, -1.2], // and rim; the room fills
];
const ROOM = 0.36; // strength of the room's light

/**
 * A view of particles in an element that has a size of its own.
 *
 * Lengths are in grid units. Colours of the target come from the element's custom properties `--ghost` and
 * `--edge`, that of particles from the look; the background is the element's own.
 */
export class Viewer {
  #queued = false;
  #observer;
  #resting = 0;
  #occlusion = null;
  #behind = null;
  #lens = 0; // in radii of what is shown
  #depth = null;
  #cast = 0; // share of the particles that cast the shadow there is; 0 where it is of something else
  #told = "";
  #spaced = false;
  #onQuality;
  #listen = new AbortController();

  /**
   * @param {HTMLElement} element where the canvas goes; takes the keyboard while it has the focus.
   * @param {object} [options]
   * @param {boolean} [options.reducedMotion]
   * @param {(view: object) => void} [options.onView] hears how the user moved the camera.
   * @param {(names: {still: string, moving: string}) => void} [options.onQuality] hears how finely is drawn.
   */
  constructor(element, { reducedMotion = false, onView = () => {}, onQuality = () => {} } = {}) {
    this.element = element;
    const { canvas, software } = freshCanvas();
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: !software, alpha: true, stencil: true });
    this.renderer.toneMapping = NeutralToneMapping;
    this.renderer.localClippingEnabled = true;
    this.quality = new Quality(software);
    this.canvas.setAttribute("role", "img");
    element.append(this.canvas);

    this.scene = new Scene();
    this.scene.environmentIntensity = ROOM;
    this.viewpoint = new Viewpoint(element, canvas, {
      reducedMotion,
      positions: () => this.particles.positions,
      onFit: ({ radius }) => {
        this.surface.setSize(radius);
        this.setCut(this.cut ?? null);
      },
      onChange: () => this.draw(),
      onMove: onView,
    });
    for (const [strength, ...place] of LAMPS) {
      const lamp = new DirectionalLight(0xffffff, strength);
      lamp.position.set(...place);
      lamp.layers.enable(BALL);
      this.camera.add(lamp, lamp.target); // both go with the camera
    }
    this.particles = new Particles();
    this.ghost = new Particles({ ghost: true });
    this.surface = new Surface();
    this.shadow = new ContactShadow();
    this.particles.layers.enable(CASTS);
    this.surface.mesh.layers.enable(CASTS);
    this.ghost.visible = this.surface.visible = false;
    this.marks = new Marks();
    this.scene.add(this.camera, this.particles, this.ghost, this.surface, this.shadow, this.marks);

    this.#onQuality = onQuality;
    this.setLook("clay");
    const { signal } = this.#listen;
    document.addEventListener("themechange", () => this.#repaint(), { signal });
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault(), { signal });
    this.canvas.addEventListener("webglcontextrestored", () => this.#restore(), { signal });
    this.#observer = new ResizeObserver(() => this.resize());
    this.#observer.observe(element);
    this.#paint();
    this.resize();
  }

  /** @returns {import("three").PerspectiveCamera} see viewpoint.js. */
  get camera() {
    return this.viewpoint.camera;
  }

  /** @returns {object} what mouse and fingers turn the camera by, see viewpoint.js. */
  get controls() {
    return this.viewpoint.controls;
  }

  /** Show the particles of a frame; the camera sees all of them until the user moves it. */
  setFrame(index, positions) {
    this.index = index;
    const others = this.particles.count !== positions.length / 3;
    if (others && !this.#spaced) this.#space(spacing(positions));
    this.particles.setPositions(positions);
    this.transform(new Matrix4());
    if (others) this.viewpoint.settle();
    else this.viewpoint.follow();
    this.draw();
  }

  /**
   * Have all of these in sight in every frame, so that none is drawn in another size than the others.
   *
   * @param {Float32Array[]} clouds the shapes that the matter comes from and goes to.
   */
  setEnds(clouds) {
    this.viewpoint.setEnds(clouds);
  }

  /** Show no particles and no surface until the next frame. */
  clear() {
    this.setSurface(null);
    this.particles.visible = false;
    this.draw();
  }

  /** Show the particles elsewhere until the next frame, where a map leads [grid units]. */
  transform(matrix) {
    matrix.decompose(this.particles.position, this.particles.quaternion, this.particles.scale);
    this.#changed();
  }

  /** @returns {number[]} the centre of the box around the particles [grid units]. */
  get centre() {
    return new Box3().setFromArray(this.particles.positions).getCenter(new Vector3()).toArray();
  }

  /** @param {Array<{at: number[], index: number}>} marks see marks.js. */
  setMarks(marks) {
    this.marks.set(marks);
    this.draw();
  }

  /**
   * The particle that is seen at a place of the window.
   *
   * @returns {number[] | null} where it is [grid units]; null beside all of them.
   */
  pick(clientX, clientY) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    const { positions } = this.particles;
    const seen = new Vector3();
    const pixels = this.viewpoint.scale(height);
    let nearest = null;
    let least = Infinity;
    for (let i = 0; i < positions.length; i += 3) {
      seen.fromArray(positions, i).applyMatrix4(this.camera.matrixWorldInverse);
      const depth = -seen.z;
      if (depth >= least || depth <= this.camera.near) continue;
      const reach = Math.max((this.particles.radius * pixels) / depth, 2);
      seen.applyMatrix4(this.camera.projectionMatrix);
      const x = left + ((seen.x + 1) / 2) * width;
      const y = top + ((1 - seen.y) / 2) * height;
      if (Math.hypot(x - clientX, y - clientY) > reach) continue;
      least = depth;
      nearest = i;
    }
    return nearest === null ? null : [...positions.slice(nearest, nearest + 3)];
  }

  /** @param {number} distance between neighbouring particles, which decides their size [grid units]. */
  setSpacing(distance) {
    this.#spaced = true;
    this.#space(distance);
  }

  /** @param {string} name of a look, see looks.js. */
  setLook(name) {
    this.look = name;
    this.surface.setLook(name);
    this.#paint();
  }

  /** @param {string} name of a level of fineness, or "auto". */
  setQuality(name) {
    this.quality.chosen = name;
    this.draw();
  }

  /** @param {string} name of how deep what is sharp reaches, see focus.js; seen at rest, and in pictures. */
  setFocus(name) {
    this.#lens = FOCUS[name].lens;
    this.draw();
  }

  #space(distance) {
    this.spacing = distance;
    this.particles.radius = RADIUS * distance;
    this.ghost.radius = GHOST_RADIUS * distance;
    this.draw();
  }

  /** @param {{positions: Float32Array} | null} points of the target; null for none. */
  setTarget(points) {
    this.ghost.visible = points !== null;
    if (points) this.ghost.setPositions(points.positions);
    this.draw();
  }

  /** @param {{vertices: Float32Array, faces: Uint32Array} | null} mesh of the target, as lines. */
  setWireframe(mesh) {
    if (this.wireframe) {
      this.scene.remove(this.wireframe);
      this.wireframe.geometry.dispose();
      this.wireframe.material.dispose();
      this.wireframe = null;
    }
    if (mesh) {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(mesh.vertices, 3));
      geometry.setIndex(new BufferAttribute(mesh.faces, 1));
      const material = new LineBasicMaterial({ transparent: true, opacity: 0.5, depthWrite: false });
      this.wireframe = new LineSegments(new WireframeGeometry(geometry), material);
      this.wireframe.frustumCulled = false;
      geometry.dispose();
      this.scene.add(this.wireframe);
      this.#paint();
    }
    this.setCut(this.cut ?? null);
  }

  /** @param {{vertices: Float32Array, faces: Uint32Array} | null} mesh shown instead of particles. */
  setSurface(mesh) {
    this.surface.visible = mesh !== null;
    this.particles.visible = mesh === null;
    this.#changed();
    if (!mesh) return;
    this.surface.setMesh(mesh);
    this.scene.environment ??= roomLight(this.renderer);
  }

  /** @param {Float32Array} vertices where those of the surface are until another one is set [grid units]. */
  moveSurface(vertices) {
    this.surface.setVertices(vertices);
    this.#changed();
  }

  /**
   * Colour the surface by values of the particles nearest to it; null for one plain colour.
   *
   * @param {Float32Array | null} values one per particle.
   * @param {{low: number, high: number, palette: string}} [scale]
   * @param {Uint32Array} [near] the particle of each vertex, see nearest.js.
   */
  setSurfaceColors(values, scale, near) {
    const plain = new Color(LOOKS[this.look].color);
    this.surface.setColors(values && byValue(values, scale, near, plain));
    this.draw();
  }

  /** @param {Float32Array} light own colours of the particles, linear, three for each. */
  setParticleLight(light) {
    this.particles.setOwn(shades(light));
    this.draw();
  }

  /**
   * @param {Float32Array} light own colours, linear, three for each vertex of the surface, or for each particle.
   * @param {Uint32Array} [near] the particle of each vertex; without it colours are of the vertices.
   */
  setSurfaceLight(light, near) {
    this.surface.setColors(near ? byParticle(light, near, new Color(LOOKS[this.look].color)) : light);
    this.draw();
  }

  /** Colour the particles by values, see Particles.setColors; null for one plain colour. */
  setColors(values, scale) {
    this.particles.setColors(values, scale);
    this.draw();
  }

  /** @param {{axis: "x"|"y"|"z", offset: number} | null} cut hides what lies beyond the offset. */
  setCut(cut) {
    this.cut = cut;
    const normal = cut ? AXES[cut.axis] : [0, 0, 0];
    for (const cloud of [this.particles, this.ghost]) {
      cloud.material.uniforms.cut.value.set(...normal, cut ? cut.offset : 1);
    }
    this.shadow.footprint.uniforms.cut.value.copy(this.particles.material.uniforms.cut.value);
    const axis = new Vector3(...normal);
    this.surface.setCut(cut && { normal: axis, offset: cut.offset, center: this.viewpoint.fitted?.center ?? new Vector3() });
    if (this.wireframe) {
      this.wireframe.material.clippingPlanes = cut ? [new Plane(axis.clone().negate(), cut.offset)] : [];
    }
    this.#changed();
  }

  /** @param {"y"|"z"} axis that points up. */
  setUp(axis) {
    if (axis === this.viewpoint.up) return;
    this.scene.environmentRotation.x = axis === "z" ? Math.PI / 2 : 0;
    this.viewpoint.setUp(axis);
  }

  /** Where the camera is, to be given to another viewer: see viewpoint.js. */
  get view() {
    return this.viewpoint.view;
  }

  set view(view) {
    this.viewpoint.view = view;
  }

  /** Where the eye is, as camera keys of exports have it: see viewpoint.js. */
  get eye() {
    return this.viewpoint.eye;
  }

  /** Look at everything from the usual side. */
  reset() {
    this.viewpoint.reset();
  }

  /** Move the camera by steps or to a side, as keys do: see viewpoint.js. */
  steer(move) {
    this.viewpoint.steer(move);
  }

  /** Turn the camera about what it looks at [radians]. */
  turn(angle) {
    this.viewpoint.turn(angle);
  }

  /**
   * Leave room for what floats over the view: the middle of what is shown goes to the middle of the rest.
   *
   * @param {{top: number, right: number, bottom: number}} sides how much of each is covered [pixels].
   */
  setCovered(sides) {
    if (this.viewpoint.setCovered(sides)) this.resize();
  }

  /** Draw at the next opportunity, once; more finely as soon as nothing changes any more. */
  draw() {
    if (this.#queued) return;
    this.#queued = true;
    requestAnimationFrame(() => {
      this.#queued = false;
      if (this.disposed) return;
      this.controls.update();
      this.canvas.setAttribute("aria-busy", "true"); // a finer picture follows
      this.render("moving");
      clearTimeout(this.#resting);
      this.#resting = setTimeout(() => this.#rest(), REST_MILLISECONDS);
    });
  }

  /** Draw now, as finely as there is time for, see quality.js. */
  render(motion = "still") {
    if (!this.canvas.width || !this.canvas.height) return;
    const { kind, quality } = this;
    const level = quality.level(kind, motion);
    const measured = quality.measures(kind, level);
    const begun = performance.now();
    this.#render(LEVELS[level].name);
    if (motion === "still") for (let point = 0; point < this.#points; point++) this.#blur(point);
    if (!measured || this.#points) return;
    const gl = this.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits until all is drawn
    quality.took(kind, level, performance.now() - begun);
  }

  /** @returns {"surface" | "points"} what is shown. */
  get kind() {
    return this.surface.visible ? "surface" : "points";
  }

  /** Draw at rest; again while it is not known yet how fine that may be. */
  #rest() {
    if (this.disposed) return;
    const { kind, quality } = this;
    const lens = this.#lens;
    this.#lens = 0;
    this.render();
    this.#lens = lens;
    if (quality.learns(kind, quality.level(kind, "still"))) {
      this.#resting = setTimeout(() => this.#rest());
      return;
    }
    this.#focus(0);
  }

  /** Blur what is nearer or farther than what is looked at, a point of the lens after the other. */
  #focus(point) {
    if (this.disposed) return;
    if (point < this.#points) {
      this.#blur(point);
      this.#resting = setTimeout(() => this.#focus(point + 1));
      return;
    }
    const { kind, quality } = this;
    this.canvas.removeAttribute("aria-busy");
    const [still, moving] = ["still", "moving"].map((motion) => LEVELS[quality.level(kind, motion)].label.toLowerCase());
    if (this.#told === still + moving) return;
    this.#told = still + moving;
    this.#onQuality({ still, moving });
  }

  /** @returns {number} how many points of a lens make up a picture at rest; 0 where all is sharp. */
  get #points() {
    return this.#lens ? POINTS : 0;
  }

  #blur(point) {
    const { renderer, camera, controls, kind, quality } = this;
    const fineness = LEVELS[quality.level(kind, "still")].name;
    const lens = this.#lens * this.viewpoint.radius;
    this.#depth ??= new DepthOfField();
    this.#depth.add(point, { renderer, camera, target: controls.target, lens }, () => this.#render(fineness));
  }

  #render(fineness) {
    const sketch = fineness === "sketch";
    const full = fineness === "full";
    const ratio = sketch ? 0.5 : Math.min(devicePixelRatio, full ? 2 : 1);
    if (this.renderer.getPixelRatio() !== ratio) this.renderer.setPixelRatio(ratio);
    const { radius, distance } = this.viewpoint;
    const share = sketch ? Math.min(1, SKETCHED / Math.max(this.particles.count, 1)) : 1;
    const pixels = this.viewpoint.scale(this.canvas.height);
    for (const cloud of [this.particles, this.ghost]) {
      cloud.thin(share);
      cloud.material.uniforms.pixels.value = pixels;
      cloud.material.uniforms.depth.value = [distance - radius, distance + radius];
    }
    this.marks.fit(1 / this.viewpoint.scale(this.canvas.clientHeight));
    if (this.#cast < share) this.#castShadow(radius, share);
    this.surface.refract(full);
    this.scene.background = full && this.surface.visible && this.surface.clear ? this.#backdrop() : null;
    if (!sketch) this.surface.shade();
    else if (this.surface.visible) this.surface.sketch(this.renderer, this.scene, this.camera);
    this.renderer.render(this.scene, this.camera);
    // what is clear has no creases, and three's pass does not know of cuts
    if (!full || !this.surface.visible || this.surface.clear || this.cut) return;
    this.#occlusion ??= new Occlusion(this.scene, this.camera);
    this.shadow.visible = false;
    this.#occlusion.render(this.renderer, radius);
    this.shadow.visible = true;
  }

  #backdrop() {
    return (this.#behind ??= backdrop(this.#colour("--scene-light"), this.#colour("--scene")));
  }

  #castShadow(radius, share) {
    this.shadow.visible = this.particles.visible || this.surface.visible;
    const { up, fitted } = this.viewpoint;
    if (!this.shadow.visible || !fitted || !this.particles.count) return;
    this.#cast = share;
    this.shadow.place(up, fitted.center, radius, this.#lowest(up));
    this.shadow.update(this.renderer, this.scene, (2 * this.particles.radius) / Math.cbrt(share));
  }

  /** @returns {number} how far down what is shown reaches along the upward axis [grid units]. */
  #lowest(up) {
    const { particles, surface } = this;
    if (surface.visible) return lowest(surface.mesh.geometry.attributes.position.array, surface.matrixWorld, up);
    particles.updateWorldMatrix(true, false);
    return lowest(particles.positions, particles.matrixWorld, up);
  }

  /** Something else is shown, or elsewhere. */
  #changed() {
    this.#cast = 0;
    this.draw();
  }

  #restore() {
    this.scene.environment &&= roomLight(this.renderer);
    this.surface.matcap.forget();
    this.#changed();
  }

  /** Fit the canvas to its element. */
  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    this.viewpoint.resize();
    this.quality.forget();
    this.draw();
  }

  /** @returns {Promise<Blob>} what is shown, as PNG, in the middle of the picture. */
  screenshot() {
    this.viewpoint.uncentre();
    this.render();
    this.viewpoint.centre();
    this.draw();
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/png"));
  }

  /**
   * Record a film, see recording.js.
   *
   * @param {(share: number) => Promise<void> | void} advance changes the picture, 0..1 of the film.
   * @param {{seconds: number, framesPerSecond?: number, signal?: AbortSignal}} options
   */
  async record(advance, options) {
    const draw = async (share) => {
      await advance(share);
      this.render();
    };
    // films are opaque, where pictures let through what is behind them
    this.renderer.setClearColor(getComputedStyle(this.element.parentElement).backgroundColor, 1);
    this.viewpoint.uncentre();
    try {
      return await record(this.canvas, draw, options);
    } finally {
      this.renderer.setClearColor(0x000000, 0);
      this.viewpoint.centre();
      this.draw();
    }
  }

  /** Free everything. */
  dispose() {
    this.disposed = true;
    this.#listen.abort();
    this.#observer.disconnect();
    this.viewpoint.dispose();
    clearTimeout(this.#resting);
    this.setWireframe(null);
    this.scene.environment?.dispose();
    this.#behind?.dispose();
    this.#occlusion?.dispose();
    this.#depth?.dispose();
    this.surface.dispose();
    this.shadow.dispose();
    this.marks.dispose();
    this.particles.dispose();
    this.ghost.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
    this.canvas.remove();
  }

  /** Colours have changed with the theme. */
  #repaint() {
    this.#behind?.dispose();
    this.#behind = null;
    this.#paint();
  }

  #paint() {
    this.particles.setPlain(LOOKS[this.look].color);
    this.ghost.setPlain(this.#colour("--ghost"));
    this.wireframe?.material.color.set(this.#colour("--edge"));
    this.draw();
  }

  #colour(name) {
    return getComputedStyle(this.element).getPropertyValue(name).trim() || "#8a94a6";
  }
}
