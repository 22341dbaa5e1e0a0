/** Keys that make the same request, sent twice, one job. */

/** A key that nobody else has. */
export function freshKey() {
  const random = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(random, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
