/** The 3D view: particles or a surface, the target as a ghost, a cut, a camera. Draws on demand. */
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
  PerspectiveCamera,
  Plane,
  Scene,
  Sphere,
  Vector3,
  WebGLRenderer,
  WireframeGeometry,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { backdrop } from "./backdrop.js";
import { CASTS, ContactShadow } from "./contact_shadow.js";
import { DepthOfField, POINTS } from "./depth_of_field.js";
import { FOCUS } from "./focus.js";
import { LOOKS } from "./looks.js";
import { Marks } from "./marks.js";
import { BALL } from "./matcap.js";
import { roomLight } from "./materials.js";
import { NONE } from "./nearest.js";
import { Occlusion } from "./occlusion.js";
import { shades } from "./own_colors.js";
import { LEVELS, palette } from "./palettes.js";
import { Particles } from "./particles.js";
import { LEVELS as FINENESS, Quality } from "./quality.js";
import { record } from "./recording.js";
import { spacing } from "./spacing.js";
import { Surface } from "./surface.js";

const FIELD_OF_VIEW = 35;
const TURN = Math.PI / 36;
const PAN_PIXELS = 24;
const ZOOM = 1.1;
const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const FROM = { y: [0.5, 0.35, 1], z: [0.5, -1, 0.35] };
const MARGIN = 1.1; // around everything in sight, for the controls
const SLACK = 1.05; // a frame may reach so far beyond what is in sight, since there is a margin
const RADIUS = 0.62; // of the spacing: neighbours touch and holes still show
const GHOST_RADIUS = 0.22;
const SKETCHED = 10_000; // particles of a sketch
const REST_MILLISECONDS = 300; // without a change, which is longer than a frame at the slowest pace
const SIDES = { 1: { y: [0, 0, 1], z: [0, -1, 0] }, 3: { y: [1, 0, 0], z: [1, 0, 0] }, 7: { y: [0, 1, 0], z: [0, 0, 1] } };
const LAMPS = [
  [1.5, -0.7, 0.9, 0.5], // strength and place beside the camera: key
  [1, 0.8, 0.5, -1.2], // and rim; the room fills
];
const ROOM = 0.36; // strength of the room's light
const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;

/**
 * A view of particles in an element that has a size of its own.
 *
 * Lengths are in grid units. Colours of the target come from the element's custom properties `--ghost` and
 * `--edge`, that of particles from the look; the background is the element's own.
 */
export class Viewer {
  #frameOf = null; // bounding sphere the camera was last fitted to
  #ends = null; // bounding sphere of the shapes that the matter comes from and goes to
  #queued = false;
  #observer;
  #up = "y";
  #silent = false;
  #touched = false;
  #resting = 0;
  #occlusion = null;
  #behind = null;
  #lens = 0; // in radii of what is shown
  #depth = null;
  #cast = 0; // share of the particles that cast the shadow there is; 0 where it is of something else
  #told = "";
  #spaced = false;
  #covered = { top: 0, right: 0, bottom: 0 };
  #reducedMotion;
  #onView;
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
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.1, 1000);
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

    this.#reducedMotion = reducedMotion;
    this.#onView = onView;
    this.#onQuality = onQuality;
    this.setLook("clay");
    this.#control();
    const { signal } = this.#listen;
    document.addEventListener("themechange", () => this.#repaint(), { signal });
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault(), { signal });
    this.canvas.addEventListener("webglcontextrestored", () => this.#restore(), { signal });
    this.#observer = new ResizeObserver(() => this.resize());
    this.#observer.observe(element);
    this.#paint();
    this.resize();
  }

  /** Show the particles of a frame; the camera sees all of them until the user moves it. */
  setFrame(index, positions) {
    this.index = index;
    const others = this.particles.count !== positions.length / 3;
    if (others && !this.#spaced) this.#space(spacing(positions));
    this.particles.setPositions(positions);
    this.transform(new Matrix4());
    if (!this.#touched && (others || !this.#framed)) this.reset();
    this.draw();
  }

  /**
   * Have all of these in sight in every frame, so that none is drawn in another size than the others.
   *
   * @param {Float32Array[]} clouds the shapes that the matter comes from and goes to.
   */
  setEnds(clouds) {
    this.#ends = ball(clouds);
    if (!this.#touched) this.reset();
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
    const pixels = height / (2 * Math.tan((FIELD_OF_VIEW * Math.PI) / 360));
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
    this.surface.setColors(values && vertexColors(values, scale, near, plain));
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
    this.surface.setColors(near ? picked(light, near, new Color(LOOKS[this.look].color)) : light);
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
    this.surface.setCut(cut && { normal: axis, offset: cut.offset, center: this.#frameOf?.center ?? new Vector3() });
    if (this.wireframe) {
      this.wireframe.material.clippingPlanes = cut ? [new Plane(axis.clone().negate(), cut.offset)] : [];
    }
    this.#changed();
  }

  /** @param {"y"|"z"} axis that points up. */
  setUp(axis) {
    if (axis === this.#up) return;
    this.#up = axis;
    this.camera.up.set(...AXES[axis]);
    this.scene.environmentRotation.x = axis === "z" ? Math.PI / 2 : 0;
    this.#control();
    this.reset();
  }

  /** Where the camera is and what it was fitted to, to be given to another viewer. */
  get view() {
    return {
      position: this.camera.position.toArray(),
      target: this.controls.target.toArray(),
      frameOf: this.#frameOf,
    };
  }

  set view({ position, target, frameOf }) {
    this.#touched = true;
    if (frameOf) this.#fit(frameOf);
    this.camera.position.fromArray(position);
    this.controls.target.fromArray(target);
    this.#quietly(() => this.controls.update());
    this.draw();
  }

  /**
   * Where the eye is, as camera keys of exports have it.
   *
   * @returns {{azimuth: number, elevation: number, zoom: number}} degrees about the upward axis and above the
   *   horizon, and how many times larger things are than where all is in sight.
   */
  get eye() {
    const arm = this.camera.position.clone().sub(this.controls.target).normalize();
    const [upward, front] = this.#up === "z" ? [arm.z, -arm.y] : [arm.y, arm.z];
    const degrees = 180 / Math.PI;
    const whole = this.#farAway(this.#frameOf?.radius ?? this.distance);
    return {
      azimuth: Math.atan2(arm.x, front) * degrees,
      elevation: Math.asin(Math.min(Math.max(upward, -1), 1)) * degrees,
      zoom: Math.min(Math.max(whole / this.distance, 0.1), 100),
    };
  }

  /**
   * Leave room for what floats over the view: the middle of what is shown goes to the middle of the rest.
   *
   * @param {{top: number, right: number, bottom: number}} sides how much of each is covered [pixels].
   */
  setCovered(sides) {
    if (Object.entries(sides).every(([name, pixels]) => this.#covered[name] === pixels)) return;
    this.#covered = sides;
    this.resize();
  }

  /** Width and height that nothing covers, at least an eighth of each [pixels]. */
  get #free() {
    const { clientWidth: width, clientHeight: height } = this.element;
    const { top, right, bottom } = this.#covered;
    return [Math.max(width - right, width / 8), Math.max(height - top - bottom, height / 8)];
  }

  /** @returns {number} from where all of a ball is in sight [grid units]. */
  #farAway(radius) {
    const narrow = Math.min(...this.#free) / Math.max(this.element.clientHeight, 1);
    return (MARGIN * radius) / Math.sin((FIELD_OF_VIEW * Math.PI) / 360) / narrow;
  }

  /** @returns {number} from the camera to what it looks at [grid units]. */
  get distance() {
    return this.camera.position.distanceTo(this.controls.target);
  }

  /** Look at everything from the usual side: at all of the ends, and at a frame that reaches beyond them. */
  reset() {
    const { positions, count } = this.particles;
    if (!this.#ends && !count) return;
    const { center, radius: least } = this.#ends ?? ball([positions]);
    const radius = Math.max(least, reach(positions, center) / SLACK);
    this.#fit(new Sphere(center, radius));
    this.#touched = false;
    this.controls.target.copy(center);
    this.camera.position
      .set(...FROM[this.#up])
      .setLength(this.#farAway(radius))
      .add(center);
    this.#quietly(() => this.controls.update());
    this.draw();
  }

  /** Take the depths that are drawn, shaded and allowed from what is in sight. */
  #fit(sphere) {
    const { radius } = sphere;
    this.#frameOf = sphere;
    this.camera.near = radius / 100;
    this.camera.far = radius * 40;
    this.controls.minDistance = radius / 10;
    this.controls.maxDistance = radius * 20;
    this.camera.updateProjectionMatrix();
    this.surface.setSize(radius);
    this.setCut(this.cut ?? null);
  }

  /**
   * Move the camera by steps or to a side, as keys do.
   *
   * @param {{turn?: number[], pan?: number[], zoom?: number, side?: string}} move
   */
  steer({ turn, pan, zoom, side }) {
    const { controls } = this;
    this.#quietly(() => {
      if (turn) {
        controls.rotateLeft(TURN * turn[0]);
        controls.rotateUp(TURN * turn[1]);
      }
      if (pan) controls.pan(PAN_PIXELS * pan[0], PAN_PIXELS * pan[1]);
      if (zoom > 0) controls.dollyIn(ZOOM);
      if (zoom < 0) controls.dollyOut(ZOOM);
      if (side) this.#lookFrom(side);
      controls.update();
    });
    this.draw();
    this.#moved();
  }

  /** 1, 3 and 7 are the front, the right and the top; 9 is the opposite side. */
  #lookFrom(side) {
    const { position } = this.camera;
    const { target } = this.controls;
    const arm = position.clone().sub(target);
    const length = arm.length();
    if (SIDES[side]) arm.set(...SIDES[side][this.#up]).setLength(length);
    else arm.negate();
    position.copy(target).add(arm);
  }

  /** Turn the camera about what it looks at [radians]. */
  turn(angle) {
    const arm = this.camera.position.clone().sub(this.controls.target);
    arm.applyAxisAngle(this.camera.up, angle);
    this.camera.position.copy(this.controls.target).add(arm);
    this.#quietly(() => this.controls.update());
    this.draw();
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
    this.#render(FINENESS[level].name);
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
    const [still, moving] = ["still", "moving"].map((motion) => FINENESS[quality.level(kind, motion)].label.toLowerCase());
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
    const fineness = FINENESS[quality.level(kind, "still")].name;
    const lens = this.#lens * (this.#frameOf?.radius ?? 10);
    this.#depth ??= new DepthOfField();
    this.#depth.add(point, { renderer, camera, target: controls.target, lens }, () => this.#render(fineness));
  }

  #render(fineness) {
    const sketch = fineness === "sketch";
    const full = fineness === "full";
    const ratio = sketch ? 0.5 : Math.min(devicePixelRatio, full ? 2 : 1);
    if (this.renderer.getPixelRatio() !== ratio) this.renderer.setPixelRatio(ratio);
    const radius = this.#frameOf?.radius ?? 10;
    const share = sketch ? Math.min(1, SKETCHED / Math.max(this.particles.count, 1)) : 1;
    const { distance } = this;
    const pixels = this.canvas.height / (2 * Math.tan((FIELD_OF_VIEW * Math.PI) / 360));
    for (const cloud of [this.particles, this.ghost]) {
      cloud.thin(share);
      cloud.material.uniforms.pixels.value = pixels;
      cloud.material.uniforms.depth.value = [distance - radius, distance + radius];
    }
    this.marks.fit((2 * Math.tan((FIELD_OF_VIEW * Math.PI) / 360)) / this.canvas.clientHeight);
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
    if (!this.shadow.visible || !this.#frameOf || !this.particles.count) return;
    this.#cast = share;
    this.shadow.place(this.#up, this.#frameOf.center, radius, this.#lowest);
    this.shadow.update(this.renderer, this.scene, (2 * this.particles.radius) / Math.cbrt(share));
  }

  /** @returns {number} how far down what is shown reaches along the upward axis [grid units]. */
  get #lowest() {
    const { particles, surface } = this;
    if (surface.visible) return lowest(surface.mesh.geometry.attributes.position.array, surface.matrixWorld, this.#up);
    particles.updateWorldMatrix(true, false);
    return lowest(particles.positions, particles.matrixWorld, this.#up);
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
    this.camera.aspect = width / height;
    this.#centre();
    this.quality.forget();
    if (!this.#touched) this.reset();
    this.draw();
  }

  /** Put what the camera looks at into the middle of what nothing covers. */
  #centre() {
    const { clientWidth: width, clientHeight: height } = this.element;
    const { top, right, bottom } = this.#covered;
    this.camera.setViewOffset(width, height, right / 2, (bottom - top) / 2, width, height);
  }

  /** @returns {Promise<Blob>} what is shown, as PNG, in the middle of the picture. */
  screenshot() {
    this.camera.clearViewOffset();
    this.render();
    this.#centre();
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
    this.camera.clearViewOffset();
    try {
      return await record(this.canvas, draw, options);
    } finally {
      this.renderer.setClearColor(0x000000, 0);
      this.#centre();
      this.draw();
    }
  }

  /** Free everything. */
  dispose() {
    this.disposed = true;
    this.#listen.abort();
    this.#observer.disconnect();
    this.controls.dispose();
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

  /** New controls, since they take the axis they turn about from the camera when they are made. */
  #control() {
    this.controls?.dispose();
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.canvas.style.touchAction = "inherit"; // the style sheet says where a finger scrolls
    this.controls.enableDamping = !this.#reducedMotion;
    this.controls.dampingFactor = 0.18;
    this.controls.addEventListener("change", () => {
      this.draw();
      if (!this.#silent) this.#moved();
    });
  }

  #moved() {
    this.#touched = true;
    this.#onView(this.view);
  }

  /** Whether a reset would change nothing; as long as no ends are known, whether all particles are in sight. */
  get #framed() {
    const seen = this.#frameOf;
    if (!seen) return false;
    const needed = reach(this.particles.positions, seen.center) / SLACK;
    return this.#ends ? seen.radius === Math.max(this.#ends.radius, needed) : seen.radius >= needed;
  }

  /** Move the camera at once, and tell nobody. */
  #quietly(move) {
    const damping = this.controls.enableDamping;
    this.#silent = true;
    this.controls.enableDamping = false;
    move();
    this.controls.enableDamping = damping;
    this.#silent = false;
  }
}

/** Colours of vertices, linear as the lights need them, shape [vertices, 3] in 0..1. */
function vertexColors(values, { low, high, palette: name }, near, plain) {
  const table = palette(name);
  const linear = (level) => {
    const shade = level / 255;
    return shade <= 0.04045 ? shade / 12.92 : ((shade + 0.055) / 1.055) ** 2.4;
  };
  const shades = Float32Array.from(table, linear);
  const out = new Float32Array(3 * near.length);
  for (let v = 0; v < near.length; v++) {
    const value = near[v] === NONE ? NaN : values[near[v]];
    if (Number.isNaN(value)) {
      plain.toArray(out, 3 * v);
      continue;
    }
    const share = Math.min(Math.max((value - low) / Math.max(high - low, 1e-9), 0), 1);
    const level = 4 * Math.round(share * (LEVELS - 1));
    out.set(shades.subarray(level, level + 3), 3 * v);
  }
  return out;
}

/** The colour of each vertex's particle; a plain one where none is near. */
function picked(light, near, plain) {
  const out = new Float32Array(3 * near.length);
  for (let v = 0; v < near.length; v++) {
    if (near[v] === NONE) plain.toArray(out, 3 * v);
    else out.set(light.subarray(3 * near[v], 3 * near[v] + 3), 3 * v);
  }
  return out;
}

let drawsOnProcessor;

/**
 * A canvas to draw on. Where no graphics card is there every pixel costs, so that the first context,
 * which finds that out, has no smooth edges and is kept.
 *
 * @returns {{canvas: HTMLCanvasElement, software: boolean}}
 */
function freshCanvas() {
  const canvas = document.createElement("canvas");
  if (drawsOnProcessor === undefined) {
    const gl = canvas.getContext("webgl2", { antialias: false, stencil: true });
    const info = gl?.getExtension("WEBGL_debug_renderer_info");
    drawsOnProcessor = SOFTWARE.test(gl?.getParameter(info?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
    if (!drawsOnProcessor) {
      gl?.getExtension("WEBGL_lose_context")?.loseContext();
      return freshCanvas();
    }
  }
  return { canvas, software: drawsOnProcessor };
}

/** The distance from a point to the farthest particle [grid units]. */
function reach(positions, { x, y, z }) {
  let farthest = 0;
  for (let i = 0; i < positions.length; i += 3) {
    const square = (positions[i] - x) ** 2 + (positions[i + 1] - y) ** 2 + (positions[i + 2] - z) ** 2;
    if (square > farthest) farthest = square;
  }
  return Math.sqrt(farthest);
}

/** A ball around the box around clouds of particles. */
function ball(clouds) {
  const box = new Box3();
  for (const positions of clouds) box.union(new Box3().setFromArray(positions));
  const center = box.getCenter(new Vector3());
  return new Sphere(center, Math.max(...clouds.map((positions) => reach(positions, center)), 0.1));
}

/** How far down points reach along the upward axis where a map leads them [grid units]. */
function lowest(positions, { elements }, up) {
  const axis = "xyz".indexOf(up);
  const [a, b, c, d] = [0, 4, 8, 12].map((column) => elements[column + axis]);
  let least = Infinity;
  for (let i = 0; i < positions.length; i += 3) {
    const height = a * positions[i] + b * positions[i + 1] + c * positions[i + 2] + d;
    if (height < least) least = height;
  }
  return least;
}
