/** Telling people who do not see the page what has changed on it. */

import { h } from "./dom.js";

const region = h("div", { class: "visually-hidden", role: "status" });
document.body.append(region);

/** Say a sentence when the screen reader has a moment. */
export function announce(sentence) {
  region.textContent = sentence;
}
