/** The ways to move the particles, one or several. */

import { h } from "../../dom.js";

/** Checkboxes of the methods; at least one stays checked. */
export class Methods {
  constructor(methods, changed) {
    const change = (event) => {
      const names = this.boxes.filter((box) => box.checked).map((box) => box.value);
      if (names.length) changed(names);
      else event.target.checked = true;
    };
    this.boxes = methods.map(({ name }) =>
      h("input", {
        type: "checkbox",
        name: "method",
        value: name,
        "aria-labelledby": `method-${name}`,
        "aria-describedby": `about-${name}`,
        on: { change },
      }),
    );
    this.element = h(
      "fieldset",
      { class: "stack" },
      h("legend", null, h("h2", null, "Method")),
      h("p", { class: "quiet" }, "Choose several to compare them; each becomes a separate job."),
      h(
        "div",
        { class: "methods" },
        methods.map(({ name, description }, index) =>
          h(
            "label",
            { class: "method" },
            this.boxes[index],
            h(
              "span",
              null,
              h("strong", { id: `method-${name}` }, name),
              h("span", { class: "quiet small", id: `about-${name}` }, description),
            ),
          ),
        ),
      ),
    );
  }

  /** Check the methods of a draft. */
  show(names) {
    for (const box of this.boxes) box.checked = names.includes(box.value);
  }
}
