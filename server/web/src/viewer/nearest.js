/** Which particle is nearest to each vertex of a surface, by cells that hold few particles each. */

export const NONE = 0xffffffff;

/**
 * @param {Float32Array} positions x y z of each particle [grid units].
 * @param {Float32Array} vertices x y z of each vertex [grid units].
 * @param {number} reach farthest that a particle is looked for [grid units].
 * @returns {Uint32Array} index of a particle for each vertex; NONE where none is within reach.
 */
export function nearest(positions, vertices, reach) {
  const count = positions.length / 3;
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i++) {
    low[i % 3] = Math.min(low[i % 3], positions[i]);
    high[i % 3] = Math.max(high[i % 3], positions[i]);
  }
  const size = high.map((top, axis) => Math.floor((top - low[axis]) / reach) + 1);
  const along = (value, axis) => Math.floor((value - low[axis]) / reach);
  const cellOf = (i) =>
    (along(positions[3 * i], 0) * size[1] + along(positions[3 * i + 1], 1)) * size[2] +
    along(positions[3 * i + 2], 2);

  // particles in the order of their cells; those of cell c are from[c] to from[c + 1]
  const from = new Uint32Array(size[0] * size[1] * size[2] + 1);
  for (let i = 0; i < count; i++) from[cellOf(i) + 1] += 1;
  for (let c = 1; c < from.length; c++) from[c] += from[c - 1];
  const next = from.slice();
  const order = new Uint32Array(count);
  for (let i = 0; i < count; i++) order[next[cellOf(i)]++] = i;

  const found = new Uint32Array(vertices.length / 3).fill(NONE);
  for (let v = 0; v < found.length; v++) {
    const [x, y, z] = vertices.subarray(3 * v, 3 * v + 3);
    const [cx, cy, cz] = [along(x, 0), along(y, 1), along(z, 2)];
    let best = reach * reach;
    for (let a = Math.max(cx - 1, 0); a <= Math.min(cx + 1, size[0] - 1); a++) {
      for (let b = Math.max(cy - 1, 0); b <= Math.min(cy + 1, size[1] - 1); b++) {
        const row = (a * size[1] + b) * size[2];
        const first = row + Math.max(cz - 1, 0);
        const last = row + Math.min(cz + 1, size[2] - 1);
        if (first > last) continue;
        for (let k = from[first]; k < from[last + 1]; k++) {
          const i = 3 * order[k];
          const square =
            (positions[i] - x) ** 2 + (positions[i + 1] - y) ** 2 + (positions[i + 2] - z) ** 2;
          if (square < best) {
            best = square;
            found[v] = order[k];
          }
        }
      }
    }
  }
  return found;
}
