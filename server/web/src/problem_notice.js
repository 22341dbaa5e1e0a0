/** A problem as a block that says what is wrong and what to do about it. */

import { h } from "./dom.js";

export function problemNotice(error) {
  return h(
    "div",
    { class: "notice bad", role: "alert" },
    h("p", null, error.message),
    error.remedy && h("p", { class: "quiet" }, error.remedy),
  );
}
