/** A labelled list to choose one from. */
import { h } from "./dom.js";

/**
 * @param {string} id of the list in the page.
 * @param {string} label
 * @param {Array<[string, string]>} options values, and what they are to the user.
 * @param {object} [more]
 * @param {string} [more.value] that is chosen at first; the first one of all if absent.
 * @param {(event: Event) => void} [more.change] hears that another one was chosen.
 * @param {string} [more.title] says more of it on hovering.
 * @returns {{select: HTMLSelectElement, field: HTMLElement}} the list, and all of it.
 */
export function choice(id, label, options, { value = options[0][0], change = () => {}, title } = {}) {
  const select = h(
    "select",
    { id, title, on: { change } },
    options.map(([option, text]) => h("option", { value: option }, text)),
  );
  select.value = value;
  return { select, field: h("div", { class: "field" }, h("label", { class: "small quiet", for: id }, label), select) };
}

/**
 * Offer some of a list only; if the chosen one is none of them, the first one is chosen.
 *
 * @param {HTMLSelectElement} select
 * @param {(value: string) => boolean} possible
 * @returns {number} how many there are.
 */
export function offer(select, possible) {
  for (const option of select.options) option.disabled = option.hidden = !possible(option.value);
  const left = [...select.options].filter((option) => !option.disabled);
  if (left.length && select.selectedOptions[0]?.disabled !== false) select.value = left[0].value;
  return left.length;
}
