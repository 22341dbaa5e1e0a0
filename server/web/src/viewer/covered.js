/** How far what floats over a view covers its sides. */

const BAR = 0.5; // what is wider than this share of the view is a bar along its upper or lower side

/**
 * @param {DOMRect} view
 * @param {DOMRect[]} pieces that float over it; those without a size cover nothing.
 * @returns {{top: number, right: number, bottom: number}} what is left between them is free [pixels].
 */
function covered(view, pieces) {
  const sides = { top: 0, right: 0, bottom: 0 };
  const atTop = (piece) => piece.top + piece.bottom < view.top + view.bottom;
  const shown = pieces.filter(({ width, height }) => width && height);
  for (const piece of shown) {
    if (piece.width > BAR * view.width) {
      if (atTop(piece)) sides.top = Math.max(sides.top, piece.bottom - view.top);
      else sides.bottom = Math.max(sides.bottom, view.bottom - piece.top);
    } else if (piece.height > piece.width) {
      sides.right = Math.max(sides.right, view.right - piece.left);
    }
  }
  return sides;
}

/**
 * Keep a viewer told of what covers its sides, as long as the signal allows.
 *
 * @param {import("./panel.js").Panel} panel of the viewer.
 * @param {HTMLElement[][]} rows what floats over it; elements side by side are one piece.
 * @param {AbortSignal} signal
 * @param {() => void} [onChange] hears that the viewer was told.
 */
export function watchCovered(panel, rows, signal, onChange = () => {}) {
  const tell = async () => {
    const viewer = await panel.viewer;
    if (!viewer || signal.aborted) return;
    viewer.setCovered(covered(panel.scene.getBoundingClientRect(), rows.map(around)));
    onChange();
  };
  const observer = new ResizeObserver(tell);
  for (const element of [panel.scene, ...rows.flat()]) observer.observe(element);
  signal.addEventListener("abort", () => observer.disconnect());
}

/** One piece for elements in a row: as wide as all of them together. */
function around(row) {
  const boxes = row.map((one) => one.getBoundingClientRect()).filter(({ width, height }) => width && height);
  if (!boxes.length) return new DOMRect();
  const width = boxes.reduce((sum, box) => sum + box.width, 0);
  const top = Math.min(...boxes.map((box) => box.top));
  return new DOMRect(boxes[0].left, top, width, Math.max(...boxes.map(({ bottom }) => bottom)) - top);
}
