/** A job as it goes on: its state, its metrics and its events, from the stream and by asking. */
import { events, get, pause } from "../../api.js";
import { lives } from "../../format.js";
import { released } from "../../press.js";

const ASK_MILLISECONDS = 2500;
const GONE = [401, 404]; // the key or the share link was revoked; the job was deleted

/**
 * Watches a job until the signal ends it. While the tab is hidden the stream is closed, since a
 * browser allows few connections; what was missed comes when it is seen again.
 */
export class Watch {
  #last = 0;
  #rows = new Map();
  #asked = 0;
  #answered = 0;

  /**
   * @param {string} jobId
   * @param {AbortSignal} signal
   * @param {object} heard
   * @param {(job: object) => void} heard.onJob
   * @param {(rows: object[]) => void} heard.onRows metrics of all frames, in order.
   * @param {(events: object[]) => void} heard.onEvents all events but those of frames.
   * @param {() => void} heard.onAnew the job began anew, and nothing of before holds.
   * @param {(connected: boolean) => void} heard.onConnection
   */
  constructor(jobId, signal, heard) {
    Object.assign(this, { jobId, signal, heard });
    this.job = null;
    this.events = [];
  }

  /** The job as it is now. */
  async ask() {
    const turn = ++this.#asked;
    const job = await get(`/jobs/${this.jobId}`, { signal: this.signal });
    await released();
    if (turn < this.#answered) return this.job; // a later answer was quicker
    this.#answered = turn;
    if (this.job && lives(this.job.state) && lives(job.state)) this.#advance(job);
    else if (job.progress.frame === 0) this.#rows.clear(); // it begins anew
    this.job = job;
    this.heard.onJob(this.job);
    return this.job;
  }

  /** Follow the job for as long as the signal allows and the job is there. */
  async run() {
    await Promise.all([this.#askOn(), this.#listenOn()]);
  }

  async #listenOn() {
    while (!this.signal.aborted) {
      await this.#stream();
      while (!this.signal.aborted && (document.hidden || !lives(this.job.state))) {
        await this.#change();
      }
    }
  }

  /** What an action of the user has changed. */
  async changed() {
    await this.ask();
    this.#wake?.();
  }

  #wake = null;

  /** Until the tab is seen or hidden, or the job has another state. */
  #change() {
    return new Promise((resolve) => {
      this.#wake = resolve;
      document.addEventListener("visibilitychange", resolve, { once: true });
      this.signal.addEventListener("abort", resolve, { once: true });
    });
  }

  async #stream() {
    const closing = new AbortController();
    const hide = () => document.hidden && closing.abort();
    document.addEventListener("visibilitychange", hide);
    const signal = AbortSignal.any([this.signal, closing.signal]);
    const onState = (state) => this.heard.onConnection(state === "connected");
    try {
      for await (const event of events(this.jobId, { after: this.#last, signal, onState })) {
        this.#take(event);
      }
      if (!signal.aborted) await this.ask();
    } catch (error) {
      if (signal.aborted) return;
      if (GONE.includes(error.status)) throw error;
      this.heard.onConnection(false);
      await pause(ASK_MILLISECONDS, this.signal);
    } finally {
      document.removeEventListener("visibilitychange", hide);
    }
  }

  #take(event) {
    if (event.type === "state") {
      if (event.data.state !== this.job.state) this.ask().catch(() => {});
      return;
    }
    if (event.id <= this.#last) {
      this.#rows.clear();
      this.events = [];
      this.heard.onAnew();
    }
    this.#last = event.id;
    if (event.type === "frame") {
      const { frame, metrics, seconds } = event.data;
      this.#rows.set(frame, { frame, ...metrics, seconds });
      this.#tellRows();
    } else {
      this.events.push(event);
      this.heard.onEvents(this.events);
    }
  }

  /** Many events come at once at the beginning; they are told of once. */
  #tellRows() {
    this.telling ??= requestAnimationFrame(() => {
      this.telling = undefined;
      if (this.signal.aborted) return;
      if (this.#advance(this.job)) this.heard.onJob(this.job);
      this.heard.onRows(this.#sorted());
    });
  }

  /** Let a job have the frames that events have told of, which may be quicker than answers. */
  #advance(job) {
    const rows = this.#sorted();
    if (rows.length <= job.progress.frame) return false;
    job.progress = { ...job.progress, frame: rows.length, metrics: rows.at(-1) };
    return true;
  }

  #sorted() {
    return [...this.#rows.values()].sort((a, b) => a.frame - b.frame);
  }

  /** Progress, place in the queue and time left, which no event tells. */
  async #askOn() {
    while (!this.signal.aborted) {
      await pause(lives(this.job.state) ? ASK_MILLISECONDS : 4 * ASK_MILLISECONDS, this.signal);
      if (this.signal.aborted || document.hidden) continue;
      const before = this.job.state;
      try {
        await this.ask();
        if (!lives(this.job.state)) this.heard.onConnection(true); // no stream tells that it is back
        if (before !== this.job.state) this.#wake?.();
      } catch (error) {
        if (GONE.includes(error.status)) throw error; // else the stream tells that the service is gone
      }
    }
  }
}
