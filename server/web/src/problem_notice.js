/** A problem as a block that says what is wrong and what to do about it. */

import { h } from "./dom.js";
import { settingName } from "./setting_titles.js";

export function problemNotice(error) {
  return h(
    "div",
    { class: "notice bad", role: "alert" },
    h("p", null, inTitles(error.message)),
    error.remedy && h("p", { class: "quiet" }, inTitles(error.remedy)),
  );
}

/** A sentence of the service, in which settings in backticks get the titles they have here. */
export function inTitles(text) {
  return text
    .split("`")
    .map((part, index) => (index % 2 ? (settingName(part) ?? h("code", null, part)) : part));
}
