/** Parts of the page, which are loaded when they are needed. */

import { Problem } from "./api.js";

/**
 * Load a part.
 *
 * @param {() => Promise<object>} load
 * @returns {Promise<object>} what it exports.
 * @throws {Problem} when it is not to be had, as once the service has another version of the page.
 */
export async function part(load) {
  try {
    return await load();
  } catch (error) {
    console.warn("not loaded", error);
    const detail = "A part of the page cannot be loaded: the service does not answer, or has a newer version of the page.";
    throw Object.assign(new Problem({ detail, remedy: "Load the page again." }), { loadAgain: true });
  }
}
