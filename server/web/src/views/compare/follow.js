/** A job of a comparison, asked for now and then: a stream for each would use up the connections. */
import { get, pause } from "../../api.js";
import { lives } from "../../format.js";

const ASK_MILLISECONDS = 1500;

/**
 * Follow a job until it rests or the signal aborts.
 *
 * @param {string} jobId
 * @param {AbortSignal} signal
 * @param {(job: object, rows: object[]) => void} tell hears the job and the metrics of its frames.
 */
export async function follow(jobId, signal, tell) {
  let first = true;
  while (!signal.aborted) {
    try {
      const [job, rows] = await Promise.all([
        get(`/jobs/${jobId}`, { signal }),
        get(`/jobs/${jobId}/metrics`, { signal }),
      ]);
      tell(job, rows);
      if (!lives(job.state)) return;
      first = false;
    } catch (error) {
      if (signal.aborted) return;
      if (first || error.status === 404) throw error;
    }
    await pause(ASK_MILLISECONDS, signal);
  }
}
