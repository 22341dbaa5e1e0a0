/** Elements from plain calls. Text is always text: no markup is ever parsed. */

const SVG = "http://www.w3.org/2000/svg";
const PROPERTIES = new Set(["value", "checked", "disabled"]);

/**
 * An HTML element.
 *
 * @param {string} tag
 * @param {object|null} attributes `on` holds listeners by event, `data` data-attributes; true is an empty attribute; null, undefined and false are left out.
 * @param {...(Node|string|number|null|false|Array)} children
 */
export function h(tag, attributes, ...children) {
  return dress(document.createElement(tag), attributes, children);
}

/** The same for SVG. */
export function svg(tag, attributes, ...children) {
  return dress(document.createElementNS(SVG, tag), attributes, children);
}

/** Replace what is in an element. */
export function fill(element, ...children) {
  element.replaceChildren(...nodes(children));
  return element;
}

/**
 * Draw a part anew if what it is drawn from has changed; the focus stays in it.
 *
 * @param {object} drawn what each part was last drawn from, by name; changed here.
 */
export function redraw(drawn, name, element, from, make) {
  const key = JSON.stringify(from);
  if (drawn[name] === key) return;
  drawn[name] = key;
  const focused = element.contains(document.activeElement);
  fill(element, make());
  if (focused) element.querySelector("button, a")?.focus();
}

function dress(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (name === "on") {
      for (const [event, listener] of Object.entries(value)) {
        element.addEventListener(event, listener);
      }
    } else if (name === "data") {
      Object.assign(element.dataset, value);
    } else if (value !== null && value !== undefined && value !== false) {
      element.setAttribute(name, value === true ? "" : value);
    }
  }
  element.append(...nodes(children));
  for (const name of PROPERTIES) {
    // after the children, since the value of a <select> needs its options
    if (attributes?.[name] !== undefined && name in element) element[name] = attributes[name];
  }
  return element;
}

function nodes(children) {
  return children
    .flat(Infinity)
    .filter((child) => child !== null && child !== undefined && child !== false)
    .map((child) => (child instanceof Node ? child : String(child)));
}

/** Open all that an element is folded into, so that it can be seen. */
export function reveal(element) {
  for (let at = element.closest("details"); at; at = at.parentElement.closest("details")) at.open = true;
}
