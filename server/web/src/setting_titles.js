/** What settings are called in the page, by path. */

import { get } from "./api.js";
import { settings } from "./config_schema.js";

/** Titles of those that have a field of their own in the form. */
export const TITLES = {
  frames: "Frames",
  "sampling.points_per_cell_edge": "Particles per cell edge",
  "sampling.fit": "Fit into the domain",
};

let asked = null;

const names = new Map(Object.entries(TITLES).map(([path, title]) => [path, `“${title}”`]));

/** @param {Array<{path: string, title: string, group: string}>} abouts all settings of the form, see config_schema.js. */
export function learnTitles(abouts) {
  for (const { path, title, group } of abouts) if (!names.has(path)) names.set(path, `“${title}” under “${group}”`);
}

/** Learn the titles of all settings from the service; where it does not tell, paths stay. */
export function learnAllTitles() {
  asked ??= get("/schemas/config", { quiet: true })
    .then((schema) => learnTitles(settings(schema)))
    .catch(() => (asked = null));
  return asked;
}

/** @returns {string | undefined} what a setting is called in a sentence, if it is one that is known. */
export function settingName(path) {
  return names.get(path);
}
