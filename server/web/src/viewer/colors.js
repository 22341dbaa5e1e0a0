/** What particles can be coloured by: computed here from positions, or by the service. */
import { field } from "../api.js";

/**
 * All colourings by name. `unit` is shown in the legend; `ratio` means that 1 is the middle and the
 * scale is logarithmic; `local` ones need no request.
 */
export const COLOURS = {
  height: { label: "Height in the source", unit: "dx", local: true },
  displacement: { label: "Displacement", unit: "dx", local: true },
  speed: { label: "Speed", unit: "dx per frame", local: true },
  target_distance: { label: "Distance to the target", unit: "dx" },
  density: { label: "Density relative to target", unit: "ratio", ratio: true },
  det_f: { label: "det F", unit: "ratio", ratio: true },
  target_hits: { label: "Particles on the same target point", unit: "count" },
  overlap: { label: "Distance to the nearest particle", unit: "h" },
};

const SAMPLES = 4000;
const WIDEST_RATIO = 8;

/**
 * Values of all particles of a frame.
 *
 * @param {string} name of the colouring.
 * @param {import("./frames.js").Frames} frames
 * @param {number} index of the frame, which is here.
 * @param {{source: Float32Array | null, up: "y" | "z", range?: object, signal?: AbortSignal}} given
 *   positions that the job starts from; the axis of height; a range that bounds what is asked for.
 * @returns {Promise<Float32Array | null>} null where it is not known.
 */
export async function values(name, frames, index, { source, up, range, signal }) {
  if (!COLOURS[name].local) {
    const linear = range && (COLOURS[name].ratio ? both(range, (x) => 2 ** x) : range);
    const found = await field(frames.jobId, index, name, {
      low: linear?.low,
      high: linear?.high,
      signal,
    });
    return COLOURS[name].ratio ? found.values.map((value) => Math.log2(value)) : found.values;
  }
  const from = name === "speed" ? before(frames, index, source) : source;
  const now = name === "height" ? source : frames.positions(index);
  if (!from || !now || from.length !== now.length) return null;
  const out = new Float32Array(now.length / 3);
  const axis = up === "z" ? 2 : 1;
  for (let i = 0; i < out.length; i++) {
    if (name === "height") {
      out[i] = now[3 * i + axis];
      continue;
    }
    const dx = now[3 * i] - from[3 * i];
    const dy = now[3 * i + 1] - from[3 * i + 1];
    const dz = now[3 * i + 2] - from[3 * i + 2];
    out[i] = Math.sqrt(dx * dx + dy * dy + dz * dz);
  }
  return out;
}

/**
 * The range of a colouring over a trajectory, from its decisive frames.
 *
 * @returns {Promise<{low: number, high: number, palette: string} | null>} of ratios, as log2.
 */
export async function range(name, frames, given) {
  const asked = decisive(name, frames).map(async (index) => {
    const all = await values(name, frames, index, { ...given, range: null });
    return all && spread(all);
  });
  const found = (await Promise.all(asked)).filter(Boolean);
  return found.length ? join(name, found) : null;
}

/** One range that holds several. */
export function join(name, ranges) {
  const low = Math.min(...ranges.map((one) => one.low));
  const high = Math.max(...ranges.map((one) => one.high));
  if (COLOURS[name].ratio) {
    const widest = Math.log2(WIDEST_RATIO);
    const reach = Math.min(Math.max(Math.abs(low), Math.abs(high), 0.1), widest);
    return { low: -reach, high: reach, palette: "diverging" };
  }
  const bottom = name === "height" ? low : name === "target_hits" ? 1 : 0;
  return { low: bottom, high: high > bottom ? high : bottom + 1, palette: "sequential" };
}

/** Frames that decide the range: the first, the middle and the last, of those that are here. */
export function decisive(name, frames) {
  if (name === "height") return [frames.near];
  const last = frames.known - 1;
  const all = [...new Set([0, last >> 1, last])];
  return COLOURS[name].local ? all.filter((index) => frames.has(index)) : all;
}

let earlier = new Float32Array(0);

function before(frames, index, source) {
  if (index === 0) return source;
  if (!frames.has(index - 1)) return null;
  const now = frames.positions(index);
  if (earlier.length !== now.length) earlier = new Float32Array(now.length);
  return frames.positions(index - 1, earlier);
}

/** Nearly all of the values lie between these; a few stray ones do not decide the colours. */
function spread(all) {
  const step = Math.max(1, Math.floor(all.length / SAMPLES));
  const some = [];
  for (let i = 0; i < all.length; i += step) if (Number.isFinite(all[i])) some.push(all[i]);
  some.sort((a, b) => a - b);
  const at = (share) => some[Math.round(share * (some.length - 1))] ?? 0;
  return { low: at(0.005), high: at(0.995) };
}

function both({ low, high }, map) {
  return { low: map(low), high: map(high) };
}
