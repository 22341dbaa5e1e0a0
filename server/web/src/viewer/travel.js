/** How the vertices of a surface go with the matter, from one frame towards the next. */
import { NONE } from "./nearest.js";

const ROUNDS = 4; // of averaging with neighbours, since particles beside each other differ

/**
 * @param {Uint32Array} faces three vertices each.
 * @param {Uint32Array} near the particle of each vertex, see nearest.js.
 * @param {Float32Array} from x y z of each particle [grid units].
 * @param {Float32Array} to where they are in the next frame.
 * @returns {Float32Array} how far each vertex goes: x y z [grid units].
 */
export function travel(faces, near, from, to) {
  let moved = new Float32Array(3 * near.length);
  let known = new Float32Array(near.length);
  for (let v = 0; v < near.length; v++) {
    if (near[v] === NONE) continue;
    known[v] = 1;
    for (let axis = 0; axis < 3; axis++) moved[3 * v + axis] = to[3 * near[v] + axis] - from[3 * near[v] + axis];
  }
  for (let round = 0; round < ROUNDS; round++) [moved, known] = averaged(faces, moved, known);
  return moved;
}

/** Each vertex's mean with its neighbours, of which those that are known count. */
function averaged(faces, moved, known) {
  const sum = moved.slice();
  const count = known.slice();
  const add = (v, u) => {
    if (!known[u]) return;
    count[v] += 1;
    for (let axis = 0; axis < 3; axis++) sum[3 * v + axis] += moved[3 * u + axis];
  };
  for (let i = 0; i < faces.length; i += 3) {
    for (let corner = 0; corner < 3; corner++) {
      // an edge belongs to two faces, which turn it opposite ways
      add(faces[i + corner], faces[i + ((corner + 1) % 3)]);
    }
  }
  for (let v = 0; v < count.length; v++) {
    if (count[v]) for (let axis = 0; axis < 3; axis++) sum[3 * v + axis] /= count[v];
  }
  return [sum, count.map(Math.sign)];
}
