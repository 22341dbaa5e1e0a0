/** Titles of the settings that have a field of their own in the form, by path. */
export const TITLES = {
  frames: "Frames",
  "sampling.points_per_cell_edge": "Particles per cell edge",
  "sampling.fit": "Fit into the domain",
};
