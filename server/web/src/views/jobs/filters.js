/** Which jobs are listed: by state, method and sweep. The choice lives in the address. */

import { get } from "../../api.js";
import { h } from "../../dom.js";
import { state as stateWord, states } from "../../format.js";

/** The filters above the list; `changed` hears the new choice. */
export class Filters {
  constructor({ state, method, sweep }, changed) {
    this.changed = changed;
    this.chosen = new Set(state?.split(",") ?? []);
    this.method = method ?? "";
    this.sweep = sweep ?? "";
    this.element = h(
      "div",
      { class: "filters" },
      h("div", { class: "row", role: "group", "aria-label": "States" }, this.buttons()),
      this.methods(),
      this.sweep &&
        h(
          "p",
          { class: "row" },
          "The jobs of one sweep. ",
          h("a", { href: "/" }, "Show all jobs"),
        ),
    );
  }

  buttons() {
    const button = (name, text) => {
      const pressed = name ? this.chosen.has(name) : this.chosen.size === 0;
      const click = (event) => {
        if (!name) this.chosen.clear();
        else if (!this.chosen.delete(name)) this.chosen.add(name);
        for (const one of event.currentTarget.parentElement.children) {
          const { state } = one.dataset;
          const on = state ? this.chosen.has(state) : this.chosen.size === 0;
          one.setAttribute("aria-pressed", String(on));
        }
        this.apply();
      };
      return h(
        "button",
        {
          class: "compact chip",
          type: "button",
          "aria-pressed": String(pressed),
          data: { state: name },
          on: { click },
        },
        text,
      );
    };
    return [button("", "All"), states.map((name) => button(name, stateWord(name)))];
  }

  methods() {
    const options = [h("option", { value: "" }, "All methods")];
    if (this.method) options.push(h("option", { value: this.method }, this.method));
    const change = (event) => {
      this.method = event.target.value;
      this.apply();
    };
    const select = h(
      "select",
      { "aria-label": "Method", value: this.method, on: { change } },
      options,
    );
    get("/methods").then(
      (all) => {
        const others = all.filter(({ name }) => name !== this.method);
        select.append(...others.map(({ name }) => h("option", { value: name }, name)));
      },
      () => {}, // the list itself tells that the service does not answer
    );
    return select;
  }

  apply() {
    this.changed({ state: [...this.chosen].join(","), method: this.method, sweep: this.sweep });
  }
}
