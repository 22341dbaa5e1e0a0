/** A soft shadow on the ground, darkest where something touches it: what a camera below the ground sees, blurred. */
import {
  Group,
  LinearFilter,
  Mesh,
  MeshBasicMaterial,
  NoBlending,
  OrthographicCamera,
  PlaneGeometry,
  ShaderMaterial,
  Vector4,
  WebGLRenderTarget,
} from "three";
import { FullScreenQuad } from "three/addons/postprocessing/Pass.js";
import { HorizontalBlurShader } from "three/addons/shaders/HorizontalBlurShader.js";
import { VerticalBlurShader } from "three/addons/shaders/VerticalBlurShader.js";

export const CASTS = 1; // the layer of what casts a shadow
const PIXELS = 256;
const REACH = 3; // edge of the ground, in radii of what stands on it
const BLURS = [2.2, 0.8]; // the second one takes away the grain of the first [pixels]

const VERTEX = /* glsl */ `
  uniform vec4 cut;
  uniform float size;
  varying float height;
  varying float beyond; // the cut

  void main() {
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    beyond = dot(cut.xyz, position) - cut.w;
    gl_PointSize = size;
    height = 0.5 + 0.5 * gl_Position.z;
  }
`;

const FRAGMENT = /* glsl */ `
  varying float height;
  varying float beyond;

  void main() {
    if (beyond > 0.0) discard;
    gl_FragColor = vec4(0.0, 0.0, 0.0, pow(1.0 - height, 3.0));
  }
`;

/** The ground, of which only the shadow is to be seen; it faces up along y. */
export class ContactShadow extends Group {
  constructor() {
    super();
    const target = () => new WebGLRenderTarget(PIXELS, PIXELS, { minFilter: LinearFilter });
    this.seen = target();
    this.passing = target();
    this.seen.texture.generateMipmaps = false;
    this.camera = new OrthographicCamera(-1, 1, 1, -1, 0, 1);
    this.camera.rotation.x = Math.PI / 2; // up, through the ground
    this.camera.layers.set(CASTS);
    this.ground = new Mesh(
      new PlaneGeometry(2, 2).rotateX(-Math.PI / 2),
      new MeshBasicMaterial({ map: this.seen.texture, transparent: true, depthWrite: false, opacity: 0.5, toneMapped: false }),
    );
    this.ground.renderOrder = -1;
    this.footprint = new ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      blending: NoBlending,
      uniforms: { cut: { value: new Vector4(0, 0, 0, 1) }, size: { value: 2 } },
    });
    this.blurs = [HorizontalBlurShader, VerticalBlurShader].map(
      ({ uniforms, vertexShader, fragmentShader }) =>
        new ShaderMaterial({ uniforms: structuredClone(uniforms), vertexShader, fragmentShader, blending: NoBlending }),
    );
    this.quad = new FullScreenQuad();
    this.add(this.ground, this.camera);
  }

  /**
   * Put the ground below something.
   *
   * @param {"y" | "z"} up
   * @param {import("three").Vector3} center of what stands on it [grid units].
   * @param {number} radius of that.
   * @param {number} level of the ground along the upward axis.
   */
  place(up, center, radius, level) {
    this.position.copy(center)[up] = level;
    this.rotation.x = up === "z" ? Math.PI / 2 : 0;
    const half = (REACH * radius) / 2;
    this.ground.scale.set(half, 1, -half); // turned over, since it is seen from the other side
    Object.assign(this.camera, { left: -half, right: half, top: half, bottom: -half, near: -0.01 * radius, far: 2 * radius });
    this.camera.updateProjectionMatrix();
  }

  /** Draw the shadow anew, of points with a diameter [grid units]. */
  update(renderer, scene, diameter) {
    this.footprint.uniforms.size.value = Math.max(1.5, (diameter / (2 * this.camera.right)) * PIXELS);
    const alpha = renderer.getClearAlpha();
    const { environment } = scene;
    renderer.setClearAlpha(0);
    scene.overrideMaterial = this.footprint;
    scene.environment = null;
    renderer.setRenderTarget(this.seen);
    renderer.clear();
    renderer.render(scene, this.camera);
    scene.overrideMaterial = null;
    scene.environment = environment;
    for (const pixels of BLURS) {
      this.#blur(renderer, this.blurs[0], "h", pixels, this.seen, this.passing);
      this.#blur(renderer, this.blurs[1], "v", pixels, this.passing, this.seen);
    }
    renderer.setRenderTarget(null);
    renderer.setClearAlpha(alpha);
  }

  dispose() {
    this.seen.dispose();
    this.passing.dispose();
    this.ground.geometry.dispose();
    this.ground.material.dispose();
    this.footprint.dispose();
    for (const blur of this.blurs) blur.dispose();
    this.quad.dispose();
  }

  #blur(renderer, blur, step, pixels, from, to) {
    blur.uniforms.tDiffuse.value = from.texture;
    blur.uniforms[step].value = pixels / PIXELS;
    this.quad.material = blur;
    renderer.setRenderTarget(to);
    this.quad.render(renderer);
  }
}
