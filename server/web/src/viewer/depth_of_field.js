/** Depth of field: the mean of pictures through many points of a lens, sharp at the distance of what is looked at. */
import { AdditiveBlending, FramebufferTexture, HalfFloatType, NoBlending, ShaderMaterial, Vector2, Vector3, WebGLRenderTarget } from "three";
import { FullScreenQuad } from "three/addons/postprocessing/Pass.js";

export const POINTS = 32; // of the lens
const TURN = Math.PI * (3 - Math.sqrt(5)); // from one point to the next, as in a sunflower

const VERTEX = /* glsl */ `
  varying vec2 place;

  void main() {
    place = uv;
    gl_Position = vec4(position, 1.0);
  }
`;

const FRAGMENT = /* glsl */ `
  uniform sampler2D seen;
  uniform float share;
  varying vec2 place;

  void main() {
    gl_FragColor = share * texture2D(seen, place);
  }
`;

export class DepthOfField {
  constructor() {
    const material = (blending) =>
      new ShaderMaterial({
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        uniforms: { seen: { value: null }, share: { value: 1 } },
        transparent: true,
        premultipliedAlpha: true,
        depthTest: false,
        depthWrite: false,
        blending,
      });
    this.adding = material(AdditiveBlending);
    this.showing = material(NoBlending);
    this.quad = new FullScreenQuad(this.adding);
    this.size = new Vector2();
  }

  /**
   * Draw through one more point of the lens, and show the mean of all until now.
   *
   * @param {number} index of the point; 0 begins anew.
   * @param {{renderer: object, camera: object, target: Vector3, lens: number}} eye the lens in grid units.
   * @param {() => void} draw draws the scene on the canvas.
   */
  add(index, { renderer, camera, target, lens }, draw) {
    if (index === 0) this.#begin(renderer);
    this.#through(index, camera, target, lens, draw);
    renderer.copyFramebufferToTexture(this.picture);
    renderer.autoClear = false;
    this.#copy(renderer, this.adding, this.picture, 1 / POINTS, this.sum);
    this.#copy(renderer, this.showing, this.sum.texture, POINTS / (index + 1), null);
    renderer.autoClear = true;
  }

  dispose() {
    this.sum?.dispose();
    this.picture?.dispose();
    this.adding.dispose();
    this.showing.dispose();
    this.quad.dispose();
  }

  #begin(renderer) {
    const { x, y } = renderer.getDrawingBufferSize(this.size);
    if (this.sum?.width !== x || this.sum.height !== y) {
      this.sum?.dispose();
      this.picture?.dispose();
      this.sum = new WebGLRenderTarget(x, y, { type: HalfFloatType, depthBuffer: false });
      this.picture = new FramebufferTexture(x, y);
    }
    const alpha = renderer.getClearAlpha();
    renderer.setClearAlpha(0);
    renderer.setRenderTarget(this.sum);
    renderer.clear();
    renderer.setRenderTarget(null);
    renderer.setClearAlpha(alpha);
  }

  #through(index, camera, target, lens, draw) {
    const { position, quaternion } = camera;
    const [place, turn] = [position.clone(), quaternion.clone()];
    const reach = lens * Math.sqrt((index + 0.5) / POINTS);
    const aside = new Vector3(Math.cos(index * TURN), Math.sin(index * TURN), 0).multiplyScalar(reach);
    position.add(aside.applyQuaternion(quaternion));
    camera.lookAt(target);
    draw();
    position.copy(place);
    quaternion.copy(turn);
  }

  #copy(renderer, material, from, share, to) {
    material.uniforms.seen.value = from;
    material.uniforms.share.value = share;
    this.quad.material = material;
    renderer.setRenderTarget(to);
    this.quad.render(renderer);
    renderer.setRenderTarget(null);
  }
}
