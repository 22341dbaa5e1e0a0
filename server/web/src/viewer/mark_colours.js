/** Colours of landmarks, in pictures and in lists. */
const COLOURS = ["#1c5fc4", "#c2410c", "#17703a", "#8a3ea8", "#a16207", "#0e7490", "#be185d", "#4d7c0f"];

/** @returns {string} the colour of the landmark with this index, from 0; white is readable on it. */
export function markColour(index) {
  return COLOURS[index % COLOURS.length];
}
