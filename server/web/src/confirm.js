/** Asking before something that cannot be undone. */

import { h } from "./dom.js";

/**
 * Ask, in a dialog of the browser's own.
 *
 * @param {{title: string, text: string, action: string}} question
 * @returns {Promise<boolean>} whether the answer was the action
 */
export function confirmed({ title, text, action }) {
  return new Promise((resolve) => {
    const dialog = h(
      "dialog",
      { "aria-labelledby": "question", "aria-describedby": "consequence" },
      h(
        "form",
        { method: "dialog", class: "stack" },
        h("h2", { id: "question" }, title),
        h("p", { id: "consequence" }, text),
        h(
          "div",
          { class: "actions" },
          h("button", { value: "no", autofocus: true }, "Keep it"),
          h("button", { value: "yes", class: "danger" }, action),
        ),
      ),
    );
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(dialog.returnValue === "yes");
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}
