/** Asking the service again and again, but not while nobody looks. */

import { pause } from "./api.js";

const SLOWEST = 30_000;

/**
 * Call a function until a signal ends it.
 *
 * @param {() => Promise<number>} ask answers how long to wait before the next call [ms]; when it
 *   throws, the wait doubles each time
 * @param {AbortSignal} signal
 * @param {(error: Error|null) => void} onTrouble hears the error, and null once it is over
 */
export async function poll(ask, signal, onTrouble) {
  let wait = 1000;
  let troubled = false;
  while (!signal.aborted) {
    try {
      wait = await ask();
      if (troubled) onTrouble(null);
      troubled = false;
    } catch (error) {
      if (signal.aborted) return;
      if (error.name !== "Problem") throw error;
      troubled = true;
      if (!error.status) error.remedy = "The page reconnects by itself when the service is back.";
      onTrouble(error);
      wait = Math.min(wait * 2, SLOWEST);
    }
    await pause(wait, signal);
    await looking(signal);
  }
}

function looking(signal) {
  if (!document.hidden) return Promise.resolve();
  return new Promise((resolve) => {
    const seen = () => document.hidden || resolve();
    document.addEventListener("visibilitychange", seen, { signal });
    signal.addEventListener("abort", resolve, { once: true });
  });
}
