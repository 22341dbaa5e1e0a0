/** How deep what is sharp reaches, by the width of the lens in radii of what is shown. */
export const FOCUS = {
  sharp: { label: "Sharp", lens: 0 },
  soft: { label: "Soft", lens: 0.12 },
  shallow: { label: "Shallow", lens: 0.3 },
};
