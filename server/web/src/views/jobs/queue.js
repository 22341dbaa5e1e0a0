/** The own queue: whether it is paused, and pausing it. */

import { announce } from "../../announce.js";
import { get, post } from "../../api.js";
import { h, redraw } from "../../dom.js";
import { plural } from "../../format.js";
import { released } from "../../press.js";
import { problemNotice } from "../../problem_notice.js";

/** What is said of the queue above the list; `changed` hears that jobs begin or wait. */
export class Queue {
  constructor(changed, signal) {
    this.changed = changed;
    this.signal = signal;
    this.trouble = h("div");
    this.state = h("div", { class: "queue" });
    this.element = h("div", null, this.state, this.trouble);
    this.drawn = {};
  }

  async refresh() {
    const status = await get("/queue", { signal: this.signal });
    await released();
    this.draw(status);
  }

  draw(status) {
    redraw(this.drawn, "state", this.state, [status], () => {
      if (status.paused) {
        const waiting = status.queued ? `${plural(status.queued, "job")} of yours will wait` : "Your jobs will wait";
        return h(
          "div",
          { class: "notice warn spread" },
          h("p", null, `Your queue is paused. ${waiting} until you unpause it.`),
          this.button("unpause", "Unpause", "Your jobs will be started again"),
        );
      }
      const any = status.queued + status.running > 0;
      return any ? this.button("pause", "Pause my queue", "No more of your jobs will be started") : [];
    });
  }

  button(action, text, said) {
    const click = async (event) => {
      const pressed = event.currentTarget;
      if (pressed.getAttribute("aria-disabled")) return;
      pressed.setAttribute("aria-disabled", "true"); // a disabled one would lose the focus
      try {
        const status = await post(`/queue/${action}`);
        this.trouble.replaceChildren();
        announce(`${said}.`);
        this.draw(status);
        await this.changed();
      } catch (error) {
        if (error.name !== "Problem") throw error;
        this.trouble.replaceChildren(problemNotice(error));
      } finally {
        pressed.removeAttribute("aria-disabled");
      }
    };
    return h("button", { class: "compact", type: "button", on: { click } }, text);
  }
}
