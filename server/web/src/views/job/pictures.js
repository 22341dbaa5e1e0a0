/** Buttons that take pictures and films of what is shown. */
import { saveBlob } from "../../api.js";
import { h } from "../../dom.js";
import { canRecord } from "../../viewer/recording.js";

const TURN_SECONDS = 6;

/**
 * @param {object} options
 * @param {import("../../viewer/panel.js").Panel} options.panel
 * @param {import("../../viewer/timeline.js").Timeline} options.timeline
 * @param {() => string} options.name what files are called, without a suffix.
 * @param {AbortSignal} options.signal
 */
export function pictures({ panel, timeline, name, signal }) {
  let recording = null;
  const film = (label, suffix, make) => {
    const button = h("button", { type: "button", class: "compact" }, label);
    button.addEventListener("click", async () => {
      if (recording) return recording.abort();
      const viewer = await panel.viewer;
      if (!viewer) return;
      timeline.stop();
      recording = new AbortController();
      const stop = AbortSignal.any([signal, recording.signal]);
      const others = [...element.querySelectorAll("button")].filter((one) => one !== button);
      for (const other of others) other.disabled = true;
      button.textContent = "Stop recording";
      try {
        const { advance, seconds } = make(viewer);
        const recorded = await viewer.record(advance, { seconds, signal: stop });
        if (!signal.aborted) saveBlob(recorded, `${name()}-${suffix}.webm`);
      } finally {
        recording = null;
        timeline.rest();
        button.textContent = label;
        for (const other of others) other.disabled = false;
      }
    });
    return button;
  };
  const turntable = (viewer) => {
    let before = 0;
    const advance = (share) => {
      viewer.turn((share - before) * 2 * Math.PI);
      before = share;
    };
    return { advance, seconds: TURN_SECONDS };
  };
  const trajectory = () => {
    const { pace, count } = timeline;
    const pictures = pace ? pace.frames.length : count;
    return {
      advance: (share) => timeline.at(timeline.momentAt(share * (pictures - 1))),
      seconds: Math.max(1, pictures / (pace ? pace.fps : Number(timeline.rate.value))),
    };
  };
  const picture = async () => {
    const viewer = await panel.viewer;
    if (viewer) saveBlob(await viewer.screenshot(), `${name()}-frame-${timeline.index + 1}.png`);
  };
  const element = h(
    "section",
    { class: "stack", "aria-labelledby": "pictures" },
    h("h2", { id: "pictures" }, "Pictures"),
    h(
      "div",
      { class: "row" },
      h("button", { type: "button", class: "compact", on: { click: picture } }, "Picture, PNG"),
      canRecord() && film("Video of the frames, WebM", "frames", trajectory),
      canRecord() && film("Turntable, WebM", "turntable", turntable),
    ),
  );
  return element;
}
