/** How far particles reach. */

import { Box3, Sphere, Vector3 } from "three";

/** The distance from a point to the farthest particle [grid units]. */
export function reach(positions, { x, y, z }) {
  let farthest = 0;
  for (let i = 0; i < positions.length; i += 3) {
    const square = (positions[i] - x) ** 2 + (positions[i + 1] - y) ** 2 + (positions[i + 2] - z) ** 2;
    if (square > farthest) farthest = square;
  }
  return Math.sqrt(farthest);
}

/** A ball around the box around clouds of particles. */
export function ball(clouds) {
  const box = new Box3();
  for (const positions of clouds) box.union(new Box3().setFromArray(positions));
  const center = box.getCenter(new Vector3());
  return new Sphere(center, Math.max(...clouds.map((positions) => reach(positions, center)), 0.1));
}

/** How far down points reach along the upward axis where a map leads them [grid units]. */
export function lowest(positions, { elements }, up) {
  const axis = "xyz".indexOf(up);
  const [a, b, c, d] = [0, 4, 8, 12].map((column) => elements[column + axis]);
  let least = Infinity;
  for (let i = 0; i < positions.length; i += 3) {
    const height = a * positions[i] + b * positions[i + 1] + c * positions[i + 2] + d;
    if (height < least) least = height;
  }
  return least;
}
