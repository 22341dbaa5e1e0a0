/** Handles in the 3D view by which what is shown is turned, scaled or moved. */
import { Euler, MathUtils, Matrix4, Object3D, Quaternion, Vector3 } from "three";
import { TransformControls } from "three/addons/controls/TransformControls.js";

const MODES = { turn: "rotate", move: "translate", scale: "scale" };
const COLOURS = ["#d64045", "#3f9b4f", "#3a66d1", "#c25e00"]; // of x, y, z and of turns about the eye; seen on light and dark
const SIZE = 2.2; // of what three.js takes for usual, which is made for larger views

/** Handles at the centre of the particles, which follow until they are let go. */
export class Gizmo {
  /**
   * @param {import("./viewer.js").Viewer} viewer
   * @param {"turn" | "move" | "scale"} mode
   * @param {(change: {turned: (angles: number[]) => number[], scale: number, move: number[]}) => void} done
   *   hears what was done once it is let go: `turned` makes of angles about x, y and z [degrees] those of
   *   both turns together, the scale is about the centre, the move in grid units
   */
  constructor(viewer, mode, done) {
    Object.assign(this, { viewer, done });
    this.handle = new Object3D();
    this.controls = new TransformControls(viewer.camera, viewer.canvas);
    this.controls.setMode(MODES[mode]);
    this.controls.setSpace("world");
    this.controls.setColors(...COLOURS);
    this.controls.size = SIZE;
    this.helper = this.controls.getHelper();
    viewer.scene.add(this.handle, this.helper);
    this.controls.attach(this.handle);
    this.controls.addEventListener("change", () => viewer.draw());
    this.controls.addEventListener("objectChange", () => this.#follow());
    this.controls.addEventListener("dragging-changed", ({ value }) => {
      viewer.controls.enabled = !value;
      if (!value) this.#let();
    });
    this.place();
  }

  /** Put the handles at the centre of the particles as they are now. */
  place() {
    this.centre = new Vector3(...this.viewer.centre);
    this.handle.position.copy(this.centre);
    this.handle.quaternion.identity();
    this.handle.scale.setScalar(1);
    this.viewer.draw();
  }

  dispose() {
    this.controls.detach();
    this.controls.dispose();
    this.viewer.scene.remove(this.handle, this.helper);
    this.viewer.canvas.style.touchAction = "inherit";
    this.viewer.controls.enabled = true;
    this.viewer.draw();
  }

  /** One factor for all axes: that of the handle that was drawn most. */
  get #scale() {
    const factors = this.handle.scale.toArray().map((one) => Math.max(Math.abs(one), 0.05));
    return factors.reduce((most, one) => (Math.abs(Math.log(one)) > Math.abs(Math.log(most)) ? one : most));
  }

  #follow() {
    const { position, quaternion } = this.handle;
    const scale = this.#scale;
    const back = new Matrix4().makeTranslation(-this.centre.x, -this.centre.y, -this.centre.z);
    const matrix = new Matrix4().compose(position, quaternion, new Vector3(scale, scale, scale)).multiply(back);
    this.viewer.transform(matrix);
  }

  #let() {
    const { position, quaternion } = this.handle;
    const move = position.clone().sub(this.centre).toArray();
    const still = quaternion.w > 1 - 1e-9 && this.#scale === 1 && move.every((one) => Math.abs(one) < 1e-6);
    const turned = (angles) => together(angles, quaternion);
    if (!still) this.done({ turned, scale: this.#scale, move });
  }
}

/** Angles of a turn by angles, and then by a quaternion [degrees, in the order XYZ]; the smaller ones of two ways. */
function together(angles, quaternion) {
  const first = new Quaternion().setFromEuler(new Euler(...angles.map(MathUtils.degToRad), "XYZ"));
  const both = new Euler().setFromQuaternion(first.premultiply(quaternion), "XYZ");
  const found = [both.x, both.y, both.z].map(MathUtils.radToDeg);
  const other = [found[0] + 180, 180 - found[1], found[2] + 180].map(small);
  const size = (way) => way.reduce((sum, angle) => sum + Math.abs(angle), 0);
  return size(other) < size(found) ? other : found;
}

/** The same angle from -180 to 180. */
function small(angle) {
  return MathUtils.euclideanModulo(angle + 180, 360) - 180;
}
