/** Numbers, times and states as words. */

const STATES = {
  queued: "Queued",
  running: "Running",
  succeeded: "Succeeded",
  failed: "Failed",
  cancelled: "Cancelled",
  timed_out: "Timed out",
};

/** A number with as many significant digits; a dash where there is none. */
export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-4) return value.toExponential(Math.max(digits - 2, 0));
  const decimals = Math.max(digits - 1 - Math.floor(Math.log10(size)), 0);
  return value.toFixed(Math.min(decimals, 6));
}

/** A whole number in groups of three digits, set apart by thin spaces. */
export function count(value) {
  if (value === null || value === undefined) return "–";
  return Math.round(value).toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/** One thing or many: `plural(2, "frame")` is "2 frames". */
export function plural(value, one, many = `${one}s`) {
  return `${count(value)} ${value === 1 ? one : many}`;
}

/** A length of time [s] in the one or two units that matter. */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  const whole = Math.round(seconds);
  if (seconds < 1) return "under 1 s";
  if (whole < 60) return `${whole} s`;
  const minutes = Math.floor(whole / 60);
  if (minutes < 60) return `${minutes} min ${whole % 60} s`.replace(/ 0 s$/, "");
  const hours = Math.floor(minutes / 60);
  if (hours < 48) return `${hours} h ${minutes % 60} min`.replace(/ 0 min$/, "");
  return `${Math.round(hours / 24)} days`;
}

/** A size of a file or of memory [bytes]. */
export function bytes(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const units = ["B", "kB", "MB", "GB", "TB"];
  const power = Math.min(Math.floor(Math.log10(Math.max(value, 1)) / 3), units.length - 1);
  const scaled = value / 1000 ** power;
  return `${power === 0 || scaled >= 100 ? Math.round(scaled) : scaled.toFixed(1)} ${units[power]}`;
}

/** A share from 0 to 1 in per cent. */
export function percent(share) {
  return Number.isFinite(share) ? `${Math.round(share * 100)} %` : "–";
}

/** A state of a job as a word. */
export function state(name) {
  return STATES[name] ?? name;
}

/** All states there are, in the order of a job's life. */
export const states = Object.keys(STATES);

/** Whether a job in this state may still change by itself. */
export function lives(name) {
  return name === "queued" || name === "running";
}

/** A point in time, short if it is today; `timeStyle` "medium" has seconds. */
export function when(text, timeStyle = "short") {
  if (!text) return "–";
  const date = new Date(text);
  const today = date.toDateString() === new Date().toDateString();
  return date.toLocaleString(
    undefined,
    today ? { timeStyle } : { dateStyle: "medium", timeStyle },
  );
}

/** How long ago a point in time is. */
export function ago(text, now = Date.now()) {
  const seconds = (now - new Date(text).getTime()) / 1000;
  if (seconds < 60) return "just now";
  if (seconds < 3600) return `${plural(Math.floor(seconds / 60), "minute")} ago`;
  if (seconds < 86400) return `${plural(Math.floor(seconds / 3600), "hour")} ago`;
  return `${plural(Math.floor(seconds / 86400), "day")} ago`;
}

/** What a job is called: its name, or what becomes what. */
export function jobName(job) {
  return job.name || jobShapes(job);
}

/** What names of shapes begin with that are letters. */
export const TEXT = "text:";

/** What becomes what in a job. */
export function jobShapes({ source_name: source, via_names: via = [], target_name: target }) {
  return [source, ...via, target].map(shapeName).join(" → ");
}

/** What a shape is called: letters in quotation marks, everything else by its name. */
function shapeName(name) {
  return name.startsWith(TEXT) ? `“${name.slice(TEXT.length)}”` : name;
}

/** What files of a job are called, without an ending. */
export function jobFileName(job) {
  return jobName(job).replaceAll(/[^\p{L}\p{N}]+/gu, "-").replaceAll(/^-|-$/g, "") || "morph";
}
