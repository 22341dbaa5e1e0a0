/** Events of a job as sentences. */
import { plural, state as stateWord } from "../../format.js";

const SAY = {
  submitted: () => "Submitted.",
  attempt: ({ attempt, resumed_frames: resumed }) =>
    resumed
      ? `Attempt ${attempt} went on after ${plural(resumed, "frame")}.`
      : `Attempt ${attempt} began.`,
  watchdog: ({ frame, message, kind }) => `Frame ${frame + 1}: ${message || kind}`,
  problem: ({ cause, remedy, retry }) =>
    [cause, remedy, retry && "It is tried again."].filter(Boolean).join(" "),
  state: ({ state }) => `${stateWord(state)}.`,
};

/** @returns {string} one sentence or a few. */
export function sentence({ type, data }) {
  return SAY[type]?.(data) ?? type;
}
