/** How many jobs fit side by side. */
export const MOST_COMPARED = 4;
