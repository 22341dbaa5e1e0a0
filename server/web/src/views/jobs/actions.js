/** What may be done with a job in its state. */

import { announce } from "../../announce.js";
import { del, post } from "../../api.js";
import { confirmed } from "../../confirm.js";
import { h } from "../../dom.js";
import { jobName, lives } from "../../format.js";
import { problemNotice } from "../../problem_notice.js";

/**
 * The buttons of a job.
 *
 * @param {object} job
 * @param {() => Promise} changed called when an action is done
 */
export function actions(job, changed) {
  const trouble = h("div");
  const button = (text, act, said) => {
    const click = async (event) => {
      const pressed = event.currentTarget;
      if (pressed.getAttribute("aria-disabled")) return;
      pressed.setAttribute("aria-disabled", "true"); // a disabled one would lose the focus
      try {
        if ((await act()) !== false) {
          announce(`${jobName(job)}: ${said}.`);
          await changed();
          const lost = document.activeElement === document.body;
          if (lost) document.getElementById("main").focus({ preventScroll: true });
        }
      } catch (error) {
        if (error.name !== "Problem") throw error;
        trouble.replaceChildren(problemNotice(error));
      } finally {
        pressed.removeAttribute("aria-disabled");
      }
    };
    const label = `${text} ${jobName(job)}`;
    return h("button", { class: "plain compact", type: "button", "aria-label": label, on: { click } }, text);
  };
  const to = (action) => post(`/jobs/${job.id}/${action}`);
  const ended = !lives(job.state);
  return [
    h(
      "div",
      { class: "row" },
      !ended && button("Cancel", () => to("cancel"), "cancelled"),
      ended && job.state !== "succeeded" && button("Resume", () => to("resume"), "resumed"),
      ended && button("Retry", () => again(job, to), "restarted"),
      h(
        "a",
        {
          class: "button plain compact",
          href: `/new?like=${job.id}`,
          "aria-label": `Change ${jobName(job)} and run it again`,
        },
        "Change",
      ),
      ended && button("Delete", () => forget(job), "deleted"),
    ),
    trouble,
  ];
}

async function again(job, to) {
  const sure =
    job.progress.frame === 0 ||
    (await confirmed({
      title: "Start again?",
      text: `The ${job.progress.frame} frames of ${jobName(job)} will be deleted and computed again.`,
      action: "Retry",
    }));
  return sure && to("retry");
}

async function forget(job) {
  const sure = await confirmed({
    title: "Delete this job?",
    text: `${jobName(job)} and all its frames will be deleted. This cannot be undone.`,
    action: "Delete",
  });
  return sure && del(`/jobs/${job.id}`);
}
