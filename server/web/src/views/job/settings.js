/** The settings of a job: those that differ from its preset first, all of them on demand. */
import { get } from "../../api.js";
import { fill, h } from "../../dom.js";
import { shared } from "../../share_link.js";

/** @returns {HTMLElement} which fills itself. */
export function settings(job, config, signal) {
  const body = h("div", { class: "stack" }, h("p", { class: "quiet" }, "Reading the settings…"));
  const section = h(
    "section",
    { class: "panel stack", "aria-labelledby": "settings" },
    h("h2", { id: "settings" }, "Settings"),
    body,
  );
  if (shared()) {
    show(body, job, config, null); // presets are no business of a share link
    return section;
  }
  get(`/presets/${encodeURIComponent(job.preset)}`, { query: { method: job.method }, signal })
    .then(({ config: preset }) => show(body, job, config, preset))
    .catch(() => !signal.aborted && show(body, job, config, null));
  return section;
}

function show(body, job, config, preset) {
  const all = flat(config);
  const usual = preset ? flat(preset) : new Map();
  const own = [...all].filter(([name, value]) => usual.has(name) && usual.get(name) !== value);
  fill(
    body,
    h(
      "p",
      null,
      `Preset ${job.preset}, method ${job.method}, seed ${job.seed}, device ${job.device}.`,
    ),
    preset &&
      (own.length
        ? table("Settings that differ from the preset", own, usual)
        : h("p", { class: "quiet" }, "All settings are those of the preset.")),
    h(
      "details",
      null,
      h("summary", null, `All ${all.size} settings`),
      table("All settings", [...all], null),
    ),
  );
}

function table(caption, rows, usual) {
  return h(
    "div",
    { class: "table-scroll", tabindex: 0, role: "region", "aria-label": caption },
    h(
      "table",
      null,
      h("caption", { class: "visually-hidden" }, caption),
      h(
        "thead",
        null,
        h(
          "tr",
          null,
          h("th", { scope: "col" }, "Setting"),
          h("th", { scope: "col" }, "Value"),
          usual && h("th", { scope: "col" }, "Preset"),
        ),
      ),
      h(
        "tbody",
        null,
        rows.map(([name, value]) =>
          h(
            "tr",
            null,
            h("th", { scope: "row" }, h("code", null, breakable(name))),
            h("td", null, value),
            usual && h("td", { class: "quiet" }, usual.get(name)),
          ),
        ),
      ),
    ),
  );
}

/** A path that may go on in the next line after a dot or an underscore. */
function breakable(path) {
  return path.split(/(?<=[._])/).flatMap((part) => [part, h("wbr")]);
}

function text(value) {
  if (!Array.isArray(value)) return String(value);
  return value.map((one) => (one !== null && typeof one === "object" ? JSON.stringify(one) : one)).join(", ");
}

/** Settings by dotted name, their values as text. */
function flat(config, prefix = "", into = new Map()) {
  for (const [name, value] of Object.entries(config)) {
    const nested = value !== null && typeof value === "object" && !Array.isArray(value);
    if (nested) flat(value, `${prefix}${name}.`, into);
    else into.set(prefix + name, text(value));
  }
  return into;
}
