/** Buttons that take pictures and films of what is shown. */
import { Problem, saveBlob } from "../../api.js";
import { fill, h } from "../../dom.js";
import { problemNotice } from "../../problem_notice.js";
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
      fill(trouble);
      try {
        const { ready, advance, seconds } = make(viewer);
        if (ready) {
          button.textContent = "Getting the surfaces…";
          await Promise.race([ready(), aborted(stop)]);
          if (stop.aborted) return;
        }
        button.textContent = "Stop recording";
        const recorded = await viewer.record(advance, { seconds, signal: stop });
        if (!signal.aborted) saveBlob(recorded, `${name()}-${suffix}.webm`);
      } catch (error) {
        if (signal.aborted) return;
        console.warn("no film", error);
        const detail = `This browser cannot record videos: ${error.message}`;
        fill(trouble, problemNotice(new Problem({ detail, remedy: "Try it again, or in another browser." })));
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
      ready: () => panel.ready(),
      advance: (share) => timeline.at(timeline.momentAt(share * (pictures - 1))),
      seconds: Math.max(1, pictures / (pace ? pace.fps : Number(timeline.rate.value))),
    };
  };
  const picture = async () => {
    const viewer = await panel.viewer;
    if (viewer) saveBlob(await viewer.screenshot(), `${name()}-frame-${timeline.index + 1}.png`);
  };
  const trouble = h("div");
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
    trouble,
  );
  return element;
}

function aborted(signal) {
  return new Promise((resolve) => signal.addEventListener("abort", resolve, { once: true }));
}
