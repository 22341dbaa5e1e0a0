/** A look as a matcap: a picture of a ball under the same light, of which a surface takes one texel a pixel. */
import { HalfFloatType, Mesh, MeshMatcapMaterial, OrthographicCamera, SphereGeometry, WebGLRenderTarget } from "three";

import { material } from "./materials.js";

export const BALL = 2; // the layer of the ball, and of lamps that shine on it
const PIXELS = 96;

/** Quick light for a surface in motion where no graphics card is; follows the camera and the look. */
export class Matcap {
  #seen = null; // from where, once the ball is drawn
  #camera = new OrthographicCamera(-1, 1, 1, -1, -1, 1);

  constructor() {
    this.target = new WebGLRenderTarget(PIXELS, PIXELS, { type: HalfFloatType });
    this.material = new MeshMatcapMaterial({ matcap: this.target.texture });
    this.ball = new Mesh(new SphereGeometry(1, 48, 24));
    this.ball.layers.set(BALL);
    this.#camera.layers.set(BALL);
  }

  /**
   * @param {string} look its name, see looks.js.
   * @param {import("three").Color} color of the ball.
   */
  setLook(look, color) {
    if (this.look === look && this.ball.material.color.equals(color)) return;
    if (this.look !== look) {
      this.ball.material.dispose();
      this.ball.material = material(look);
      this.look = look;
    }
    this.ball.material.color.copy(color);
    this.forget();
  }

  /** Take over from a surface's material what is not light. */
  follow({ vertexColors, clippingPlanes, side }) {
    const { material: made } = this;
    const { opacity } = this.ball.material.userData;
    const through = opacity < 1;
    if (made.vertexColors !== vertexColors || made.side !== side || made.transparent !== through) made.needsUpdate = true;
    Object.assign(made, { vertexColors, clippingPlanes, side, opacity, transparent: through });
  }

  /** Draw the ball anew at the next opportunity. */
  forget() {
    this.#seen = null;
  }

  /** Draw the ball as a camera sees it, unless it has not moved. */
  update(renderer, scene, camera) {
    if (this.#seen?.equals(camera.matrixWorld)) return;
    this.#seen = camera.matrixWorld.clone();
    this.#camera.quaternion.copy(camera.quaternion);
    renderer.setRenderTarget(this.target);
    renderer.render(scene, this.#camera);
    renderer.setRenderTarget(null);
  }

  dispose() {
    this.target.dispose();
    this.material.dispose();
    this.ball.geometry.dispose();
    this.ball.material.dispose();
  }
}
