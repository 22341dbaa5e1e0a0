/** A drawer beside the view, or on a phone below it: one sheet at a time, chosen by tabs. */
import { h } from "../dom.js";
import { iconButton } from "../icons.js";
import { query, setQuery } from "../navigation.js";

const PLACE = "details"; // in the address

/** What else is known, out of the way until it is wanted; the address says which sheet is open. */
export class Drawer {
  /** @param {{name: string, title: string, content: HTMLElement[]}[]} sheets */
  constructor(sheets) {
    this.sheets = sheets.map(({ name, title, content }) => {
      const tab = h(
        "button",
        {
          type: "button",
          role: "tab",
          id: `tab-${name}`,
          "aria-controls": `sheet-${name}`,
          on: { click: () => this.open(name), keydown: (event) => this.#key(event) },
        },
        title,
      );
      const sheet = h(
        "div",
        { class: "sheet stack", role: "tabpanel", id: `sheet-${name}`, "aria-labelledby": tab.id, tabindex: 0 },
        content,
      );
      return { name, tab, sheet };
    });
    this.toggle = iconButton("Details", "details", () => this.#switch(), {
      key: "N",
      "aria-controls": "drawer",
    });
    this.element = h(
      "aside",
      { class: "drawer", id: "drawer", "aria-label": "Details", on: { keydown: (event) => this.#escape(event) } },
      h(
        "div",
        { class: "drawer-head" },
        h("div", { role: "tablist", "aria-label": "Details" }, this.sheets.map(({ tab }) => tab)),
        iconButton("Close the details", "close", () => this.close(), { key: "N" }),
      ),
      this.sheets.map(({ sheet }) => sheet),
    );
    const wanted = query(PLACE);
    const known = this.sheets.some(({ name }) => name === wanted);
    this.#show(known ? wanted : null);
  }

  /** Open at a sheet. */
  open(name) {
    this.#show(name);
    setQuery(PLACE, name);
  }

  close() {
    const inside = this.element.contains(document.activeElement);
    this.#show(null);
    setQuery(PLACE, null);
    if (inside) this.toggle.focus();
  }

  #switch() {
    if (this.element.hidden) this.open(this.last ?? this.sheets[0].name);
    else this.close();
  }

  #show(wanted) {
    this.last = wanted ?? this.last;
    this.element.hidden = wanted === null;
    this.toggle.setAttribute("aria-expanded", String(wanted !== null));
    for (const { name, tab, sheet } of this.sheets) {
      const chosen = name === (wanted ?? this.sheets[0].name);
      sheet.hidden = !chosen;
      tab.setAttribute("aria-selected", String(chosen));
      tab.tabIndex = chosen ? 0 : -1;
    }
  }

  #key(event) {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by) return;
    event.preventDefault();
    const at = this.sheets.findIndex(({ tab }) => tab === event.currentTarget);
    const { name, tab } = this.sheets.at((at + by) % this.sheets.length);
    this.open(name);
    tab.focus();
  }

  #escape(event) {
    if (event.key === "Escape") this.close();
  }
}
