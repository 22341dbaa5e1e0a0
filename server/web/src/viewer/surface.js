/** A surface in one of the looks; where a plane cuts it, the cut is closed by a cap. */
import {
  AlwaysStencilFunc,
  BackSide,
  BufferAttribute,
  BufferGeometry,
  Color,
  DecrementWrapStencilOp,
  DoubleSide,
  FrontSide,
  Group,
  IncrementWrapStencilOp,
  KeepStencilOp,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  NotEqualStencilFunc,
  Plane,
  PlaneGeometry,
  ReplaceStencilOp,
  Vector3,
} from "three";

import { LOOKS } from "./looks.js";
import { Matcap } from "./matcap.js";
import { material, refract, sized } from "./materials.js";

/** A closed surface; what is inside a cut is found by counting faces in the stencil buffer. */
export class Surface extends Group {
  #plane = new Plane();

  constructor() {
    super();
    this.size = 10;
    this.matcap = new Matcap();
    this.material = new MeshStandardMaterial();
    this.mesh = new Mesh(new BufferGeometry(), this.material);
    this.counters = [
      counter(BackSide, IncrementWrapStencilOp, this.#plane),
      counter(FrontSide, DecrementWrapStencilOp, this.#plane),
    ];
    this.cap = cap();
    this.mesh.renderOrder = 2;
    this.mesh.frustumCulled = false;
    this.add(this.mesh, ...this.counters, this.cap, this.matcap.ball);
    this.setCut(null);
  }

  /** @param {{vertices: Float32Array, faces: Uint32Array, normals?: Float32Array}} mesh [grid units]. */
  setMesh(mesh) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(mesh.vertices, 3));
    geometry.setIndex(new BufferAttribute(mesh.faces, 1));
    if (!mesh.normals) {
      geometry.computeVertexNormals();
      mesh.normals = geometry.attributes.normal.array;
    } else {
      geometry.setAttribute("normal", new BufferAttribute(mesh.normals, 3));
    }
    this.mesh.geometry.dispose();
    for (const one of [this.mesh, ...this.counters]) one.geometry = geometry;
  }

  /** @param {Float32Array} vertices where those of the mesh are for now [grid units]. */
  setVertices(vertices) {
    const { position } = this.mesh.geometry.attributes;
    position.array = vertices;
    position.needsUpdate = true;
  }

  /** @param {string} name of the look. */
  setLook(name) {
    const before = this.material;
    const made = material(name);
    sized(made, this.size);
    made.vertexColors = before.vertexColors ?? false;
    made.clippingPlanes = before.clippingPlanes ?? null;
    before.dispose();
    this.mesh.material = this.material = made;
    this.look = name;
    this.cap.material.color.set(LOOKS[name].color).multiplyScalar(0.85);
    this.#tint();
  }

  /** @param {number} size of what is shown [grid units], which light that goes through it depends on. */
  setSize(size) {
    this.size = size;
    sized(this.material, size);
  }

  /** @param {Float32Array | null} colors linear, shape [vertices, 3]; null for that of the look. */
  setColors(colors) {
    const made = this.material;
    if (colors) this.mesh.geometry.setAttribute("color", new BufferAttribute(colors, 3));
    if (made.vertexColors !== Boolean(colors)) {
      made.vertexColors = Boolean(colors);
      made.needsUpdate = true;
    }
    this.#tint();
  }

  /**
   * @param {{normal: Vector3, offset: number, center: Vector3} | null} cut takes away what lies beyond the
   *   offset along the normal.
   */
  setCut(cut) {
    for (const one of [...this.counters, this.cap]) one.visible = cut !== null;
    this.material.clippingPlanes = cut ? [this.#plane] : null;
    if (!cut) return;
    const { normal, offset, center } = cut;
    this.#plane.set(normal.clone().negate(), offset);
    this.#plane.projectPoint(center, this.cap.position);
    this.cap.quaternion.setFromUnitVectors(new Vector3(0, 0, 1), normal);
    this.cap.scale.setScalar(4 * this.size);
  }

  /** Whether light goes through it. */
  get clear() {
    return this.material.userData.transmission > 0;
  }

  /** Draw light that goes through it as it is refracted, or in a quicker way. */
  refract(refracts) {
    refract(this.material, refracts);
    // both sides where there may be holes, or light comes through; else one, which the other would shine through
    this.material.side = this.clear && !refracts ? FrontSide : DoubleSide;
  }

  /** Light every pixel by itself, as the look has it. */
  shade() {
    this.mesh.material = this.material;
  }

  /** Light it by a matcap, which takes a fraction of the time. */
  sketch(renderer, scene, camera) {
    this.matcap.follow(this.material);
    this.matcap.update(renderer, scene, camera);
    this.mesh.material = this.matcap.material;
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.material.dispose();
    this.matcap.dispose();
    for (const one of [...this.counters, this.cap]) one.material.dispose();
    this.cap.geometry.dispose();
  }

  #tint() {
    const made = this.material;
    made.color = new Color(made.vertexColors ? "white" : LOOKS[this.look].color);
    this.matcap.setLook(this.look, made.color);
  }
}

function counter(side, operation, plane) {
  const made = new MeshBasicMaterial({
    side,
    clippingPlanes: [plane],
    colorWrite: false,
    depthWrite: false,
    depthTest: false,
    stencilWrite: true,
    stencilFunc: AlwaysStencilFunc,
    stencilFail: operation,
    stencilZFail: operation,
    stencilZPass: operation,
  });
  const mesh = new Mesh(undefined, made);
  mesh.frustumCulled = false;
  return mesh;
}

function cap() {
  const made = new MeshStandardMaterial({
    roughness: 0.8,
    side: DoubleSide,
    stencilWrite: true,
    stencilRef: 0,
    stencilFunc: NotEqualStencilFunc,
    stencilFail: KeepStencilOp,
    stencilZFail: KeepStencilOp,
    stencilZPass: ReplaceStencilOp,
  });
  const mesh = new Mesh(new PlaneGeometry(), made);
  mesh.renderOrder = 1;
  mesh.onAfterRender = (renderer) => renderer.clearStencil();
  return mesh;
}
