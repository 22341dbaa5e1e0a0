/** A cloud of particles as one draw call: each point is shaded as if it were a lit sphere. */
import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DataTexture,
  DynamicDrawUsage,
  LinearFilter,
  LinearSRGBColorSpace,
  Points,
  ShaderMaterial,
  Vector4,
} from "three";

import { LEVELS, palette } from "./palettes.js";

const VERTEX = /* glsl */ `
  uniform float radius;
  uniform float pixels;
  uniform vec4 cut;
  uniform vec2 depth;
  uniform vec2 range;
  uniform bool coloured;
  uniform bool owned;
  uniform vec3 plain;
  uniform sampler2D colours;
  attribute float value;
  attribute vec3 own;
  varying vec3 colour;

  void main() {
    vec4 seen = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * seen;
    gl_PointSize = max(2.0 * radius * pixels / -seen.z, 1.5);
    if (dot(cut.xyz, position) > cut.w) {
      gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    }
    colour = owned ? own : plain;
    if (coloured && value == value) {
      float t = clamp((value - range.x) / max(range.y - range.x, 1e-9), 0.0, 1.0);
      colour = texture2D(colours, vec2((t * 255.0 + 0.5) / 256.0, 0.5)).rgb;
    }
    float away = clamp((-seen.z - depth.x) / (depth.y - depth.x), 0.0, 1.0);
    colour *= mix(1.08, 0.68, away);
  }
`;

const FRAGMENT = /* glsl */ `
  varying vec3 colour;

  void main() {
    vec2 at = 2.0 * gl_PointCoord - 1.0;
    float r2 = dot(at, at);
    if (r2 > 1.0) discard;
    vec3 normal = vec3(at.x, -at.y, sqrt(1.0 - r2));
    float light = 0.52 + 0.54 * max(dot(normal, vec3(-0.37, 0.56, 0.74)), 0.0);
    float gloss = 0.16 * pow(max(dot(normal, vec3(-0.20, 0.30, 0.93)), 0.0), 16.0);
    gl_FragColor = vec4(colour * light + gloss, 1.0);
  }
`;

const GHOST_FRAGMENT = /* glsl */ `
  uniform float opacity;
  varying vec3 colour;

  void main() {
    vec2 at = 2.0 * gl_PointCoord - 1.0;
    if (dot(at, at) > 1.0) discard;
    gl_FragColor = vec4(colour, opacity);
  }
`;

/** Lit particles, or with `ghost` a translucent cloud that hides nothing behind it. */
export class Particles extends Points {
  /** @param {{ghost?: boolean}} options */
  constructor({ ghost = false } = {}) {
    const table = new DataTexture(new Uint8Array(palette("sequential")), LEVELS, 1);
    table.magFilter = LinearFilter;
    table.needsUpdate = true;
    super(
      new BufferGeometry(),
      new ShaderMaterial({
        vertexShader: VERTEX,
        fragmentShader: ghost ? GHOST_FRAGMENT : FRAGMENT,
        transparent: ghost,
        depthWrite: !ghost,
        uniforms: {
          radius: { value: 0 },
          pixels: { value: 500 },
          cut: { value: new Vector4(0, 0, 0, 1) },
          depth: { value: [0, 100] },
          range: { value: [0, 1] },
          coloured: { value: false },
          owned: { value: false },
          plain: { value: [0.5, 0.5, 0.5] },
          colours: { value: table },
          opacity: { value: 0.3 },
        },
      }),
    );
    this.frustumCulled = false;
    this.radius = 0.2; // [grid units]
    this.shown = "sequential";
  }

  /** @returns {number} how many particles there are. */
  get count() {
    return this.geometry.attributes.position?.count ?? 0;
  }

  /** @returns {Float32Array} x y z of each particle [grid units]. */
  get positions() {
    return this.geometry.attributes.position?.array ?? new Float32Array(0);
  }

  /** @param {Float32Array} positions x y z of each particle [grid units]; copied. */
  setPositions(positions) {
    if (this.count !== positions.length / 3) {
      this.geometry.dispose();
      this.geometry = new BufferGeometry();
      this.#add("position", positions.length, 3);
      this.#add("value", positions.length / 3, 1);
      const own = new BufferAttribute(new Uint8Array(positions.length), 3, true);
      this.geometry.setAttribute("own", own.setUsage(DynamicDrawUsage));
      this.geometry.setIndex(new BufferAttribute(shuffled(positions.length / 3), 1));
      this.material.uniforms.coloured.value = this.material.uniforms.owned.value = false;
    }
    this.#fill("position", positions);
  }

  /**
   * @param {Float32Array | null} values one per particle, NaN where there is none; null for plain.
   * @param {{low: number, high: number, palette?: "sequential" | "diverging"}} [scale]
   */
  setColors(values, scale) {
    const uniforms = this.material.uniforms;
    uniforms.coloured.value = values !== null && values.length === this.count;
    uniforms.owned.value = false;
    if (!uniforms.coloured.value) return;
    this.#fill("value", values);
    uniforms.range.value = [scale.low, scale.high];
    const name = scale.palette ?? "sequential";
    if (name !== this.shown) {
      uniforms.colours.value.image.data.set(palette(name));
      uniforms.colours.value.needsUpdate = true;
      this.shown = name;
    }
  }

  /** @param {Uint8Array} rgb a colour of its own for each particle, sRGB. */
  setOwn(rgb) {
    const uniforms = this.material.uniforms;
    uniforms.coloured.value = false;
    uniforms.owned.value = rgb.length === 3 * this.count;
    if (uniforms.owned.value) this.#fill("own", rgb);
  }

  /** @param {number} share of the particles that are drawn, larger so as to fill the same space. */
  thin(share) {
    this.geometry.setDrawRange(0, Math.ceil(share * this.count));
    this.material.uniforms.radius.value = this.radius / Math.cbrt(share);
  }

  /** @param {string} css the colour of particles without a value. */
  setPlain(css) {
    const { r, g, b } = new Color().setStyle(css, LinearSRGBColorSpace);
    this.material.uniforms.plain.value = [r, g, b];
  }

  /** Free what the graphics card holds. */
  dispose() {
    this.geometry.dispose();
    this.material.uniforms.colours.value.dispose();
    this.material.dispose();
  }

  #add(name, length, size) {
    const attribute = new BufferAttribute(new Float32Array(length), size);
    this.geometry.setAttribute(name, attribute.setUsage(DynamicDrawUsage));
  }

  #fill(name, numbers) {
    const attribute = this.geometry.attributes[name];
    attribute.array.set(numbers);
    attribute.needsUpdate = true;
  }
}

/** The numbers 0 to count - 1 in an order of no pattern, so that a part of them is everywhere. */
function shuffled(count) {
  const order = Uint32Array.from({ length: count }, (_, i) => i);
  let state = 1;
  for (let i = count - 1; i > 0; i--) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    const j = Math.floor((state / 2 ** 32) * (i + 1));
    [order[i], order[j]] = [order[j], order[i]];
  }
  return order;
}
