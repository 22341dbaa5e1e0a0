/** Landmarks of a job in its view: where each began, where it is to end, and where it is now. */

/** @returns {object[]} the landmarks of a job in grid units; none if it has none. */
export function inGridUnits({ placement }, { method }) {
  if (!placement) return [];
  return (method.landmarks ?? []).map((landmark, index) => ({
    index,
    name: landmark.name || `Landmark ${index + 1}`,
    source: under(placement.source, landmark.source),
    target: under(placement.target, landmark.target),
  }));
}

/** The particle that begins nearest to each landmark. */
export function followed(landmarks, positions) {
  return landmarks.map(({ source: [x, y, z] }) => {
    let least = Infinity;
    let nearest = 0;
    for (let i = 0; i < positions.length; i += 3) {
      const square = (positions[i] - x) ** 2 + (positions[i + 1] - y) ** 2 + (positions[i + 2] - z) ** 2;
      if (square < least) [least, nearest] = [square, i / 3];
    }
    return nearest;
  });
}

/** How far a particle of a frame is from a point [grid units]. */
export function distance(positions, particle, point) {
  return Math.hypot(...point.map((one, axis) => positions[3 * particle + axis] - one));
}

/** A point under an affine map, four rows that act on columns. */
export function under(matrix, [x, y, z]) {
  return matrix.slice(0, 3).map(([a, b, c, d]) => a * x + b * y + c * z + d);
}
