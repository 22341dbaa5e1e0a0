/** The API key of this tab, and asking for it when the service wants one. */

import { h } from "./dom.js";
import { shared, sharedSecret } from "./share_link.js";

const PLACE = "morph-key";
let asking = null;
let declined = false;

/** The key, or what a share link has in its place, or an empty text. */
export function key() {
  if (shared()) return sharedSecret();
  return sessionStorage.getItem(PLACE) ?? "";
}

/** Forget the key. */
export function forgetKey() {
  sessionStorage.removeItem(PLACE);
  document.dispatchEvent(new CustomEvent("keychange"));
}

/** Whether the service wants a key and has been given none. */
export function missing() {
  return declined;
}

/** Ask again although somebody has said "not now". */
export function askAgain() {
  declined = false;
}

/**
 * Ask for a key, once for all requests that wait for it.
 *
 * @param {Error} problem why one is needed; thrown if none is given
 */
export function askForKey(problem) {
  if (declined || shared()) return Promise.reject(problem);
  asking ??= prompt(problem).finally(() => (asking = null));
  return asking;
}

function prompt(problem) {
  return new Promise((resolve, reject) => {
    const input = h("input", {
      id: "key",
      type: "password",
      required: true,
      autocomplete: "off",
      spellcheck: "false",
    });
    const dialog = h(
      "dialog",
      { class: "dialog", "aria-labelledby": "key-title" },
      h(
        "form",
        { method: "dialog", class: "stack" },
        h("h2", { id: "key-title" }, "A key is required"),
        h("p", null, problem.message),
        h("div", { class: "field" }, h("label", { for: "key" }, "API key"), input),
        h(
          "p",
          { class: "quiet" },
          "It is kept until this tab is closed. An administrator of the service makes keys with ",
          h("code", null, "morph keys create"),
          ".",
        ),
        h(
          "div",
          { class: "actions" },
          h("button", { type: "button", on: { click: () => dialog.close() } }, "Not now"),
          h("button", { class: "primary", value: "use" }, "Use this key"),
        ),
      ),
    );
    dialog.addEventListener("close", () => {
      const given = dialog.returnValue === "use" ? input.value.trim() : "";
      dialog.remove();
      declined = !given;
      if (given) sessionStorage.setItem(PLACE, given);
      document.dispatchEvent(new CustomEvent("keychange"));
      return given ? resolve() : reject(problem);
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}
