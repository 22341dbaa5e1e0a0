/** A problem as a block that says what is wrong and what to do about it. */

import { h } from "./dom.js";
import { learnAllTitles, settingName } from "./setting_titles.js";

const PATH = /^[a-z_]+(\.[a-z_]+)*$/;

export function problemNotice(error) {
  return h(
    "div",
    { class: "notice bad", role: "alert" },
    h("p", null, inTitles(error.message)),
    error.remedy && h("p", { class: "quiet" }, inTitles(error.remedy)),
    error.loadAgain && h("p", null, h("button", { type: "button", class: "compact", on: { click: () => location.reload() } }, "Load again")),
  );
}

/** A sentence of the service, in which settings in backticks get the titles they have here. */
export function inTitles(text) {
  return text
    .split("`")
    .map((part, index) => (index % 2 ? (settingName(part) ?? code(part)) : part));
}

/** What may be a setting whose title is not known yet: until it is, by its path. */
function code(part) {
  const shown = h("code", null, part);
  if (PATH.test(part)) {
    learnAllTitles().then(() => {
      const name = settingName(part);
      if (name) shown.replaceWith(name);
    });
  }
  return shown;
}
