/** The 3D view: particles or a surface, the target as a ghost, a cut, a camera. Draws on demand. */
import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  Color,
  DirectionalLight,
  DoubleSide,
  HemisphereLight,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshLambertMaterial,
  PerspectiveCamera,
  Plane,
  Scene,
  Sphere,
  Vector3,
  WebGLRenderer,
  WireframeGeometry,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { NONE } from "./nearest.js";
import { LEVELS, palette } from "./palettes.js";
import { Particles } from "./particles.js";
import { record } from "./recording.js";
import { spacing } from "./spacing.js";

const FIELD_OF_VIEW = 35;
const TURN = Math.PI / 36;
const PAN_PIXELS = 24;
const ZOOM = 1.1;
const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const FROM = { y: [0.5, 0.35, 1], z: [0.5, -1, 0.35] };
const RADIUS = 0.62; // of the spacing: neighbours touch and holes still show
const GHOST_RADIUS = 0.22;
const COARSE = { above: 12000, share: 0.25, pixelRatio: 0.5, milliseconds: 180 };
const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;

/**
 * A view of particles in an element that has a size of its own.
 *
 * Lengths are in grid units. Colours of plain things come from the element's custom properties
 * `--particle`, `--ghost` and `--edge`; the background is the element's own.
 */
export class Viewer {
  #frameOf = null; // bounding sphere the camera was last fitted to
  #queued = false;
  #observer;
  #up = "y";
  #silent = false;
  #touched = false;
  #refining = 0;
  #spaced = false;
  #reducedMotion;
  #onView;
  #listen = new AbortController();

  /**
   * @param {HTMLElement} element where the canvas goes; takes the keyboard while it has the focus.
   * @param {{reducedMotion?: boolean, onView?: (view: object) => void}} options
   *   `onView` hears how the user moved the camera.
   */
  constructor(element, { reducedMotion = false, onView = () => {} } = {}) {
    this.element = element;
    const { canvas, software } = freshCanvas();
    this.software = software;
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: !software, alpha: true });
    if (software) this.renderer.setPixelRatio(COARSE.pixelRatio); // as the first picture will be
    this.canvas.setAttribute("role", "img");
    element.append(this.canvas);

    this.scene = new Scene();
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.1, 1000);
    const lamp = new DirectionalLight(0xffffff, 2.4);
    lamp.position.set(-0.6, 0.7, 0.6);
    this.camera.add(lamp);
    this.scene.add(this.camera, new HemisphereLight(0xffffff, 0x505860, 1.2));
    this.particles = new Particles();
    this.ghost = new Particles({ ghost: true });
    this.ghost.visible = false;
    this.scene.add(this.particles, this.ghost);

    this.#reducedMotion = reducedMotion;
    this.#onView = onView;
    this.#control();
    const { signal } = this.#listen;
    element.addEventListener("keydown", (event) => this.#key(event), { signal });
    document.addEventListener("themechange", () => this.#paint(), { signal });
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault(), { signal });
    this.canvas.addEventListener("webglcontextrestored", () => this.draw(), { signal });
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
    if (!this.#touched && (others || !this.#contains(positions))) this.reset();
    this.draw();
  }

  /** Show no particles and no surface until the next frame. */
  clear() {
    this.setSurface(null);
    this.particles.visible = false;
    this.draw();
  }

  /** @param {number} distance between neighbouring particles, which decides their size [grid units]. */
  setSpacing(distance) {
    this.#spaced = true;
    this.#space(distance);
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
    this.#replace("wireframe", mesh, (geometry) => {
      const lines = new WireframeGeometry(geometry);
      geometry.dispose();
      const material = new LineBasicMaterial({ transparent: true, opacity: 0.5, depthWrite: false });
      return new LineSegments(lines, material);
    });
    this.setCut(this.cut ?? null);
  }

  /** @param {{vertices: Float32Array, faces: Uint32Array} | null} mesh shown instead of particles. */
  setSurface(mesh) {
    this.#replace("surface", mesh, (geometry) => {
      geometry.computeVertexNormals();
      return new Mesh(geometry, new MeshLambertMaterial({ side: DoubleSide }));
    });
    this.particles.visible = mesh === null;
    this.setCut(this.cut ?? null);
  }

  /**
   * Colour the surface by values of the particles nearest to it; null for one plain colour.
   *
   * @param {Float32Array | null} values one per particle.
   * @param {{low: number, high: number, palette: string}} [scale]
   * @param {Uint32Array} [near] the particle of each vertex, see nearest.js.
   */
  setSurfaceColors(values, scale, near) {
    if (!this.surface) return;
    const { geometry, material } = this.surface;
    material.vertexColors = values !== null;
    material.needsUpdate = true;
    if (values) {
      const plain = new Color(this.#colour("--particle"));
      geometry.setAttribute("color", new BufferAttribute(vertexColors(values, scale, near, plain), 3));
    }
    this.#paint();
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
    this.renderer.localClippingEnabled = cut !== null;
    const planes = cut ? [new Plane(new Vector3(...normal).negate(), cut.offset)] : [];
    for (const object of [this.surface, this.wireframe]) {
      if (object) object.material.clippingPlanes = planes;
    }
    this.draw();
  }

  /** @param {"y"|"z"} axis that points up. */
  setUp(axis) {
    if (axis === this.#up) return;
    this.#up = axis;
    this.camera.up.set(...AXES[axis]);
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

  /** @returns {number} from the camera to what it looks at [grid units]. */
  get distance() {
    return this.camera.position.distanceTo(this.controls.target);
  }

  /** Look at everything from the usual side. */
  reset() {
    const clouds = [this.particles, this.ghost].filter(({ count }) => count);
    const box = new Box3();
    for (const { positions } of clouds) box.union(new Box3().setFromArray(positions));
    if (box.isEmpty()) return;
    const center = box.getCenter(new Vector3());
    const radius = Math.max(...clouds.map(({ positions }) => reach(positions, center)), 0.1);
    this.#fit(new Sphere(center, radius));
    this.#touched = false;
    const narrow = Math.min(1, this.camera.aspect);
    const distance = (1.02 * radius) / Math.sin((FIELD_OF_VIEW * Math.PI) / 360) / narrow;
    this.controls.target.copy(center);
    this.camera.position
      .set(...FROM[this.#up])
      .setLength(distance)
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
  }

  /** Turn the camera about what it looks at [radians]. */
  turn(angle) {
    const arm = this.camera.position.clone().sub(this.controls.target);
    arm.applyAxisAngle(this.camera.up, angle);
    this.camera.position.copy(this.controls.target).add(arm);
    this.#quietly(() => this.controls.update());
    this.draw();
  }

  /** Draw at the next opportunity, once; coarsely first where drawing is slow. */
  draw() {
    if (this.#queued) return;
    this.#queued = true;
    requestAnimationFrame(() => {
      this.#queued = false;
      if (this.disposed) return;
      this.controls.update();
      const slow = this.software && this.particles.visible && this.particles.count > COARSE.above;
      this.render({ coarse: slow });
      clearTimeout(this.#refining);
      if (slow) this.#refining = setTimeout(() => this.disposed || this.render(), COARSE.milliseconds);
    });
  }

  /** Draw now, every particle or, coarsely, some of them with fewer pixels. */
  render({ coarse = false } = {}) {
    const ratio = coarse ? COARSE.pixelRatio : this.software ? 1 : Math.min(devicePixelRatio, 2);
    if (this.renderer.getPixelRatio() !== ratio) this.renderer.setPixelRatio(ratio);
    for (const cloud of [this.particles, this.ghost]) cloud.thin(coarse ? COARSE.share : 1);
    const { width, height } = this.canvas;
    const pixels = height / (2 * Math.tan((FIELD_OF_VIEW * Math.PI) / 360));
    const { distance } = this;
    const radius = this.#frameOf?.radius ?? 10;
    for (const cloud of [this.particles, this.ghost]) {
      cloud.material.uniforms.pixels.value = pixels;
      cloud.material.uniforms.depth.value = [distance - radius, distance + radius];
    }
    if (width && height) this.renderer.render(this.scene, this.camera);
  }

  /** Fit the canvas to its element. */
  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** @returns {Promise<Blob>} what is shown, as PNG. */
  screenshot() {
    this.render();
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
    try {
      return await record(this.canvas, draw, options);
    } finally {
      this.renderer.setClearColor(0x000000, 0);
      this.draw();
    }
  }

  /** Free everything. */
  dispose() {
    this.disposed = true;
    this.#listen.abort();
    this.#observer.disconnect();
    this.controls.dispose();
    this.setWireframe(null);
    this.setSurface(null);
    this.particles.dispose();
    this.ghost.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
    this.canvas.remove();
  }

  #replace(name, mesh, make) {
    if (this[name]) {
      this.scene.remove(this[name]);
      this[name].geometry.dispose();
      this[name].material.dispose();
      this[name] = null;
    }
    if (mesh) {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(mesh.vertices, 3));
      geometry.setIndex(new BufferAttribute(mesh.faces, 1));
      this[name] = make(geometry);
      this[name].frustumCulled = false;
      this.scene.add(this[name]);
      this.#paint();
    }
    this.draw();
  }

  #paint() {
    this.particles.setPlain(this.#colour("--particle"));
    this.ghost.setPlain(this.#colour("--ghost"));
    const surface = this.surface?.material;
    surface?.color.set(surface.vertexColors ? "white" : this.#colour("--particle"));
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

  #contains(positions) {
    const seen = this.#frameOf;
    return seen !== null && reach(positions, seen.center) <= 1.05 * seen.radius;
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

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { controls } = this;
    const by = event.shiftKey
      ? (x, y) => controls.pan(PAN_PIXELS * x, PAN_PIXELS * y)
      : (x, y) => (controls.rotateLeft(TURN * x), controls.rotateUp(TURN * y));
    const actions = {
      ArrowLeft: () => by(1, 0),
      ArrowRight: () => by(-1, 0),
      ArrowUp: () => by(0, 1),
      ArrowDown: () => by(0, -1),
      "+": () => controls.dollyIn(ZOOM),
      "=": () => controls.dollyIn(ZOOM),
      "-": () => controls.dollyOut(ZOOM),
      0: () => this.reset(),
      Home: () => this.reset(),
    };
    if (!actions[event.key]) return;
    event.preventDefault();
    this.#quietly(actions[event.key]);
    this.#moved();
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
    const gl = canvas.getContext("webgl2", { antialias: false });
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
