/** How far apart the particles of a cloud are, from a sample of them. */

const SAMPLES = 48;

/**
 * The median distance from a particle to its nearest neighbour.
 *
 * @param {Float32Array} positions x y z of each particle [grid units].
 * @returns {number} [grid units]; 0.5 where fewer than two particles are.
 */
export function spacing(positions) {
  const count = positions.length / 3;
  if (count < 2) return 0.5;
  const nearest = [];
  for (let s = 0; s < SAMPLES; s++) {
    const chosen = Math.floor((s * count) / SAMPLES);
    const [x, y, z] = positions.subarray(3 * chosen, 3 * chosen + 3);
    let best = Infinity;
    for (let i = 0; i < count; i++) {
      if (i === chosen) continue;
      const dx = positions[3 * i] - x;
      const dy = positions[3 * i + 1] - y;
      const dz = positions[3 * i + 2] - z;
      best = Math.min(best, dx * dx + dy * dy + dz * dz);
    }
    nearest.push(Math.sqrt(best));
  }
  nearest.sort((a, b) => a - b);
  return nearest[SAMPLES >> 1] || 0.5;
}
