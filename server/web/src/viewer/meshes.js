/** Triangle meshes of the service. */
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

import { binary } from "../api.js";

/**
 * A mesh that the service sends as GLB.
 *
 * @returns {Promise<{vertices: Float32Array, faces: Uint32Array, light: Float32Array | null, headers: Headers}>} [grid
 *   units]; `light` are linear colours of the vertices, if they have any.
 */
export async function mesh(path, { query, signal } = {}) {
  const { buffer, headers } = await binary(path, { query: { ...query, format: "glb" }, signal });
  const { scene } = await new GLTFLoader().parseAsync(buffer, "");
  scene.updateMatrixWorld(true);
  let found = null;
  scene.traverse((object) => {
    if (object.isMesh && !found) found = object;
  });
  if (!found) return { vertices: new Float32Array(0), faces: new Uint32Array(0), light: null, headers };
  const geometry = found.geometry.applyMatrix4(found.matrixWorld);
  const vertices = geometry.attributes.position.array;
  const faces = geometry.index
    ? new Uint32Array(geometry.index.array)
    : Uint32Array.from({ length: vertices.length / 3 }, (_, i) => i);
  return { vertices, faces, light: lightOf(geometry.attributes.color), headers };
}

/** Red, green and blue of each vertex. */
function lightOf(colours) {
  if (!colours) return null;
  const light = new Float32Array(3 * colours.count);
  for (let i = 0; i < colours.count; i++) light.set([colours.getX(i), colours.getY(i), colours.getZ(i)], 3 * i);
  return light;
}
