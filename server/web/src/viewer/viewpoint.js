/** Where the 3D view is seen from: a camera that has everything in sight until the user moves it. */

import { PerspectiveCamera, Sphere, Vector3 } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { ball, reach } from "./bounds.js";

const FIELD_OF_VIEW = 35; // degrees
const HALF_ANGLE = (FIELD_OF_VIEW * Math.PI) / 360;
const TURN = Math.PI / 36;
const PAN_PIXELS = 24;
const ZOOM = 1.1;
const UPWARD = { y: [0, 1, 0], z: [0, 0, 1] };
const FROM = { y: [0.5, 0.35, 1], z: [0.5, -1, 0.35] };
const MARGIN = 1.1; // around everything in sight, for the controls
const SLACK = 1.05; // a frame may reach so far beyond what is in sight, since there is a margin
const SIDES = { 1: { y: [0, 0, 1], z: [0, -1, 0] }, 3: { y: [1, 0, 0], z: [1, 0, 0] }, 7: { y: [0, 1, 0], z: [0, 0, 1] } };

/** The camera and its controls. Lengths are in grid units. */
export class Viewpoint {
  #ends = null; // bounding sphere of the shapes that the matter comes from and goes to
  #touched = false; // by the user, who keeps the view that was chosen
  #silent = false;
  #covered = { top: 0, right: 0, bottom: 0 };

  /**
   * @param {HTMLElement} element whose size the view has.
   * @param {HTMLCanvasElement} canvas that fingers and mouse turn.
   * @param {object} options
   * @param {boolean} options.reducedMotion
   * @param {() => Float32Array} options.positions of the particles shown.
   * @param {(ball: Sphere) => void} options.onFit hears what the view was fitted to.
   * @param {() => void} options.onChange hears that there is something to draw.
   * @param {(view: object) => void} options.onMove hears how the user moved the camera.
   */
  constructor(element, canvas, { reducedMotion, positions, onFit, onChange, onMove }) {
    Object.assign(this, { element, canvas, reducedMotion, positions, onFit, onChange, onMove });
    this.up = "y";
    this.fitted = null; // bounding sphere of what the view was last fitted to
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.1, 1000);
    this.#control();
  }

  /** @returns {number} pixels that a length of one takes at a distance of one. */
  scale(height) {
    return height / (2 * Math.tan(HALF_ANGLE));
  }

  /** @returns {number} from the camera to what it looks at. */
  get distance() {
    return this.camera.position.distanceTo(this.controls.target);
  }

  /** @returns {number} how large the ball is that the view was fitted to, or may be. */
  get radius() {
    return this.fitted?.radius ?? 10;
  }

  /** Have all of these clouds in sight in every frame. */
  setEnds(clouds) {
    this.#ends = ball(clouds);
    this.settle();
  }

  /** @param {"y"|"z"} axis that points up. */
  setUp(axis) {
    this.up = axis;
    this.camera.up.set(...UPWARD[axis]);
    this.#control();
    this.reset();
  }

  /** Look at everything from the usual side: at all of the ends, and at a frame that reaches beyond them. */
  reset() {
    const positions = this.positions();
    if (!this.#ends && !positions.length) return;
    const { center, radius: least } = this.#ends ?? ball([positions]);
    const radius = Math.max(least, reach(positions, center) / SLACK);
    this.#fit(new Sphere(center, radius));
    this.#touched = false;
    this.controls.target.copy(center);
    this.camera.position
      .set(...FROM[this.up])
      .setLength(this.#farAway(radius))
      .add(center);
    this.#quietly(() => this.controls.update());
    this.onChange();
  }

  /** Look at everything, unless the user has chosen where to look. */
  settle() {
    if (!this.#touched) this.reset();
  }

  /** The same where a frame is not in sight as a whole. */
  follow() {
    if (!this.#framed) this.settle();
  }

  /** Where the camera is and what it was fitted to, to be given to another one. */
  get view() {
    return {
      position: this.camera.position.toArray(),
      target: this.controls.target.toArray(),
      frameOf: this.fitted,
    };
  }

  set view({ position, target, frameOf }) {
    this.#touched = true;
    if (frameOf) this.#fit(frameOf);
    this.camera.position.fromArray(position);
    this.controls.target.fromArray(target);
    this.#quietly(() => this.controls.update());
    this.onChange();
  }

  /**
   * Where the eye is, as camera keys of exports have it.
   *
   * @returns {{azimuth: number, elevation: number, zoom: number}} degrees about the upward axis and above the
   *   horizon, and how many times larger things are than where all is in sight.
   */
  get eye() {
    const arm = this.camera.position.clone().sub(this.controls.target).normalize();
    const [upward, front] = this.up === "z" ? [arm.z, -arm.y] : [arm.y, arm.z];
    const degrees = 180 / Math.PI;
    const whole = this.#farAway(this.fitted?.radius ?? this.distance);
    return {
      azimuth: Math.atan2(arm.x, front) * degrees,
      elevation: Math.asin(Math.min(Math.max(upward, -1), 1)) * degrees,
      zoom: Math.min(Math.max(whole / this.distance, 0.1), 100),
    };
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
    this.onChange();
    this.#moved();
  }

  /** Turn the camera about what it looks at [radians]. */
  turn(angle) {
    const arm = this.camera.position.clone().sub(this.controls.target);
    arm.applyAxisAngle(this.camera.up, angle);
    this.camera.position.copy(this.controls.target).add(arm);
    this.#quietly(() => this.controls.update());
    this.onChange();
  }

  /**
   * Leave room for what floats over the view.
   *
   * @param {{top: number, right: number, bottom: number}} sides how much of each is covered [pixels].
   * @returns {boolean} whether that is news.
   */
  setCovered(sides) {
    if (Object.entries(sides).every(([name, pixels]) => this.#covered[name] === pixels)) return false;
    this.#covered = sides;
    return true;
  }

  /** Have the proportions of the element. */
  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    this.camera.aspect = width / height;
    this.centre();
    this.settle();
  }

  /** Put what the camera looks at into the middle of what nothing covers. */
  centre() {
    const { clientWidth: width, clientHeight: height } = this.element;
    const { top, right, bottom } = this.#covered;
    this.camera.setViewOffset(width, height, right / 2, (bottom - top) / 2, width, height);
  }

  /** Put it into the middle of the picture. */
  uncentre() {
    this.camera.clearViewOffset();
  }

  /** Stop listening. */
  dispose() {
    this.controls.dispose();
  }

  /** 1, 3 and 7 are the front, the right and the top; 9 is the opposite side. */
  #lookFrom(side) {
    const { position } = this.camera;
    const { target } = this.controls;
    const arm = position.clone().sub(target);
    const length = arm.length();
    if (SIDES[side]) arm.set(...SIDES[side][this.up]).setLength(length);
    else arm.negate();
    position.copy(target).add(arm);
  }

  /** Take the depths that are drawn and allowed from what is in sight. */
  #fit(sphere) {
    const { radius } = sphere;
    this.fitted = sphere;
    this.camera.near = radius / 100;
    this.camera.far = radius * 40;
    this.controls.minDistance = radius / 10;
    this.controls.maxDistance = radius * 20;
    this.camera.updateProjectionMatrix();
    this.onFit(sphere);
  }

  /** Whether a reset would change nothing; as long as no ends are known, whether all particles are in sight. */
  get #framed() {
    if (!this.fitted) return false;
    const needed = reach(this.positions(), this.fitted.center) / SLACK;
    const { radius } = this.fitted;
    return this.#ends ? radius === Math.max(this.#ends.radius, needed) : radius >= needed;
  }

  /** @returns {number} from where all of a ball is in sight. */
  #farAway(radius) {
    const { clientWidth: width, clientHeight: height } = this.element;
    const { top, right, bottom } = this.#covered;
    const free = Math.min(Math.max(width - right, width / 8), Math.max(height - top - bottom, height / 8));
    return (MARGIN * radius) / Math.sin(HALF_ANGLE) / (free / Math.max(height, 1));
  }

  /** New controls, since they take the axis they turn about from the camera when they are made. */
  #control() {
    this.controls?.dispose();
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.canvas.style.touchAction = "inherit"; // the style sheet says where a finger scrolls
    this.controls.enableDamping = !this.reducedMotion;
    this.controls.dampingFactor = 0.18;
    this.controls.addEventListener("change", () => {
      this.onChange();
      if (!this.#silent) this.#moved();
    });
  }

  #moved() {
    this.#touched = true;
    this.onMove(this.view);
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
