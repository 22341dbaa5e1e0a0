/** Events of a job as sentences. */
import { plural, state as stateWord } from "../../format.js";

/** What goes on before the first frame. */
export const STAGES = {
  filling: "Filling the shapes with particles.",
  preparing: "Preparing the method.",
  computing: "Computing the first frame.",
};

const SAY = {
  submitted: () => "Submitted.",
  attempt: ({ attempt, resumed_frames: resumed }) =>
    resumed
      ? `Attempt ${attempt} continued after ${plural(resumed, "frame")}.`
      : `Attempt ${attempt} started.`,
  stage: ({ stage }) => STAGES[stage],
  watchdog: ({ frame, message, kind }) =>
    kind === "placement" ? message : `Frame ${frame + 1}: ${message || kind}`,
  problem: ({ cause, remedy, retry }) =>
    [cause, remedy, retry && "It will be tried again."].filter(Boolean).join(" ").replaceAll("`", ""),
  state: ({ state }) => `${stateWord(state)}.`,
};

/** @returns {string} one sentence or a few. */
export function sentence({ type, data }) {
  return SAY[type]?.(data) ?? type;
}
