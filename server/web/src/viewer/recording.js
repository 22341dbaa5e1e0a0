/** A canvas that changes in time, as a WebM film. */

const TYPES = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];
const BITS_PER_SECOND = 12e6;

/** @returns {boolean} whether this browser can record. */
export function canRecord() {
  return typeof MediaRecorder === "function" && Boolean(type());
}

/**
 * Record what a canvas shows.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {(share: number) => Promise<void> | void} draw draws the picture of a share 0..1 of the film.
 * @param {{seconds: number, framesPerSecond?: number, signal?: AbortSignal}} options
 * @returns {Promise<Blob>} a WebM file.
 */
export async function record(canvas, draw, { seconds, framesPerSecond = 30, signal }) {
  const stream = canvas.captureStream(0);
  const [track] = stream.getVideoTracks();
  const source = track.requestFrame ? track : stream; // which it is in Firefox
  const recorder = new MediaRecorder(stream, {
    mimeType: type(),
    videoBitsPerSecond: BITS_PER_SECOND,
  });
  const parts = [];
  recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
  const stopped = new Promise((resolve) => recorder.addEventListener("stop", resolve));
  recorder.start();
  const count = Math.max(2, Math.round(seconds * framesPerSecond));
  const begun = performance.now();
  try {
    for (let i = 0; i < count && !signal?.aborted; i++) {
      await draw(i / (count - 1));
      source.requestFrame();
      const due = begun + ((i + 1) * 1000) / framesPerSecond;
      await new Promise((resolve) => setTimeout(resolve, Math.max(0, due - performance.now())));
    }
  } finally {
    recorder.stop();
    await stopped;
    track.stop();
  }
  return new Blob(parts, { type: "video/webm" });
}

function type() {
  return TYPES.find((name) => MediaRecorder.isTypeSupported(name));
}
