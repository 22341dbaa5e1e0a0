/** How many jobs fit side by side. */
export const MAX_COMPARED = 4;
