/** The service as the page sees it: JSON, bytes, points and events, with a key where one is needed. */

import { askForKey, key } from "./key.js";

const ROOT = "/v1";

/** What is larger is saved by the browser itself [bytes]. */
const LARGEST_BLOB = 64e6;

/** An answer other than the one asked for; its message is a sentence to show. */
export class Problem extends Error {
  constructor({ status = 0, title = "", detail = "", remedy = "", errors = [] }) {
    super(detail || title || "The service gave no reason.");
    this.name = "Problem";
    Object.assign(this, { status, title, detail, remedy, errors });
  }
}

/** Whether what went wrong may soon be over, as when the service starts again or has much to do. */
export function passes({ name, status }) {
  return name === "Problem" && (!status || status === 429 || status >= 500);
}

/** JSON at an address below /v1; a quiet request asks for no key where one is wanted. */
export async function get(path, { query, signal, quiet } = {}) {
  return received(await request("GET", path, { query, signal, quiet }), "json");
}

/** Send JSON, or a Blob as it is; answers JSON. */
export async function post(path, body, { idempotencyKey, query, signal } = {}) {
  const headers = {};
  if (idempotencyKey) headers["Idempotency-Key"] = idempotencyKey;
  const plain = body instanceof Blob || body === undefined || body === null;
  if (!plain) headers["Content-Type"] = "application/json";
  const payload = plain ? body : JSON.stringify(body);
  const response = await request("POST", path, { query, signal, headers, body: payload });
  const text = await received(response, "text");
  return text ? JSON.parse(text) : null;
}

/** Delete what is at an address. */
export async function del(path, { signal } = {}) {
  await request("DELETE", path, { signal });
}

/** Bytes and headers. */
export async function binary(path, { query, signal } = {}) {
  const response = await request("GET", path, { query, signal });
  return { buffer: await received(response, "arrayBuffer"), headers: response.headers };
}

/** A picture as the address of a blob, which the caller revokes; an <img> sends no key itself. */
export async function picture(path, { query, signal } = {}) {
  const response = await request("GET", path, { query, signal });
  return URL.createObjectURL(await received(response, "blob"));
}

/**
 * Points of a frame or of a shape [grid units].
 *
 * @returns {Promise<{positions: Float32Array, count: number, index: number, headers: Headers}>}
 *   x y z of each point in turn; the index of the frame, or -1.
 */
export async function points(path, { query, signal } = {}) {
  const { buffer, headers } = await binary(path, { query: { ...query, format: "u16" }, signal });
  const positions = scaled(new Uint16Array(buffer), headers);
  const index = Number(headers.get("Morph-Frame") ?? -1);
  return { positions, count: positions.length / 3, index, headers };
}

/** The particles that a shape becomes before any job, see `points`; the query says how it is filled. */
export function particles(shape, options) {
  const place = shape.mesh ? `/meshes/${shape.mesh}` : `/shapes/${encodeURIComponent(shape.shape)}`;
  return points(`${place}/particles`, options);
}

/** One value per particle of a frame, and the range they were asked or found in. */
export async function field(jobId, frame, name, { low, high, signal } = {}) {
  const { buffer, headers } = await binary(`/jobs/${jobId}/frames/${frame}/fields/${name}`, {
    query: { format: "u8", low, high },
    signal,
  });
  return {
    values: scaled(new Uint8Array(buffer), headers),
    low: Number(headers.get("Morph-Low")),
    high: Number(headers.get("Morph-High")),
  };
}

/**
 * Colours of the particles in each shape of a job.
 *
 * @returns {Promise<{bytes: Uint8Array, reached: number[]} | null>} as OwnColors takes them, see own_colors.js; null
 *   where no shape has colours.
 */
export async function colours(jobId, { signal } = {}) {
  const { buffer, headers } = await binary(`/jobs/${jobId}/colors`, { signal });
  if (!buffer.byteLength) return null;
  return { bytes: new Uint8Array(buffer), reached: headers.get("Morph-Reached").split(",").map(Number) };
}

/** Let the browser save what is at an address. */
export async function save(path, name, { query, signal } = {}) {
  const looking = new AbortController();
  const either = AbortSignal.any([looking.signal, signal].filter(Boolean));
  const response = await request("GET", path, { query, signal: either });
  const size = Number(response.headers.get("Content-Length") ?? Infinity);
  if (key() || size <= LARGEST_BLOB) return saveBlob(await received(response, "blob"), name);
  // a link sends no key and tells of no refusal, but keeps what is large out of the page's memory
  looking.abort();
  saveFrom(url(path, query), name);
}

/** Let the browser save what is in a blob. */
export function saveBlob(blob, name) {
  const address = URL.createObjectURL(blob);
  saveFrom(address, name);
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

function saveFrom(address, name) {
  const link = document.createElement("a");
  link.download = name;
  link.href = address;
  link.click();
}

/**
 * Send a file and tell how much of it is on its way, from 0 to 1.
 *
 * @returns {Promise<object>} the JSON of the answer
 */
export function upload(path, file, { query, signal, onProgress = () => {} } = {}) {
  return new Promise((resolve, reject) => {
    const sending = new XMLHttpRequest(); // fetch does not tell how far an upload has come
    sending.open("POST", url(path, query));
    if (key()) sending.setRequestHeader("Authorization", `Bearer ${key()}`);
    sending.setRequestHeader("Content-Type", "application/octet-stream");
    sending.upload.onprogress = (event) => onProgress(event.loaded / (event.total || 1));
    sending.onerror = () => reject(unreachable());
    sending.onabort = () => reject(new DOMException("Left.", "AbortError"));
    sending.onload = () => {
      const body = parsed(sending.responseText);
      if (sending.status < 400) return resolve(body);
      const problem = new Problem({ status: sending.status, ...body });
      if (sending.status !== 401) return reject(problem);
      const again = () => upload(path, file, { query, signal, onProgress });
      return askForKey(problem).then(again).then(resolve, reject);
    };
    signal?.addEventListener("abort", () => sending.abort(), { once: true });
    sending.send(file);
  });
}

/**
 * What happens to a job, from after an event on until the job rests; reconnects for ever.
 *
 * @param {string} jobId
 * @param {{after?: number, signal?: AbortSignal, onState?: (state: string) => void}} options
 *   `onState` hears "connected" and "reconnecting".
 * @yields {{id: number, type: string, at: string, data: object}}
 */
export async function* events(jobId, { after = 0, signal, onState = () => {} } = {}) {
  let last = after;
  for (let failures = 0; !signal?.aborted; failures += 1) {
    try {
      const response = await request("GET", `/jobs/${jobId}/events`, {
        signal,
        headers: { Accept: "text/event-stream", ...(last && { "Last-Event-ID": String(last) }) },
      });
      onState("connected");
      let state = null;
      for await (const event of messages(response.body)) {
        failures = 0;
        last = event.id; // which begins anew when the job does
        if (event.type === "state") state = event.data.state;
        yield event;
      }
      if (state && state !== "queued" && state !== "running") return;
    } catch (error) {
      if (signal?.aborted) return;
      const final = error instanceof Problem && error.status >= 400 && error.status < 500;
      if (final && error.status !== 429) throw error;
    }
    onState("reconnecting");
    await pause(Math.min(500 * 2 ** failures, 10_000), signal);
  }
}

/** Wait [ms], or until a signal ends the wait. */
export function pause(milliseconds, signal) {
  return new Promise((resolve) => {
    const end = () => {
      clearTimeout(timer);
      signal?.removeEventListener("abort", end);
      resolve();
    };
    const timer = setTimeout(end, milliseconds);
    signal?.addEventListener("abort", end);
  });
}

async function request(method, path, { query, signal, headers = {}, body, quiet } = {}) {
  const sent = { ...headers };
  if (key()) sent.Authorization = `Bearer ${key()}`;
  let response;
  try {
    response = await fetch(url(path, query), { method, signal, body, headers: sent });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw unreachable();
  }
  if (response.ok) return response;
  const found = new Problem({ status: response.status, ...parsed(await received(response, "text")) });
  if (response.status !== 401 || quiet) throw found;
  await askForKey(found);
  return request(method, path, { query, signal, headers, body });
}

/** The body of an answer, which may break off when the service or the network does. */
async function received(response, kind) {
  try {
    return await response[kind]();
  } catch (error) {
    throw error.name === "AbortError" ? error : unreachable();
  }
}

function url(path, query) {
  const search = new URLSearchParams();
  for (const [name, value] of Object.entries(query ?? {})) {
    for (const one of [value].flat()) {
      if (one !== undefined && one !== null && one !== "") search.append(name, one);
    }
  }
  return ROOT + path + (search.size ? `?${search}` : "");
}

async function* messages(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      const blocks = (rest + value).replaceAll("\r\n", "\n").split("\n\n");
      rest = blocks.pop();
      for (const block of blocks) {
        const data = block
          .split("\n")
          .filter((line) => line.startsWith("data:"))
          .map((line) => line.slice(5).trimStart());
        if (data.length) yield JSON.parse(data.join("\n"));
      }
    }
  } finally {
    reader.cancel().catch(() => {});
  }
}

function scaled(levels, headers) {
  const offset = Number(headers.get("Morph-Offset") ?? 0);
  const scale = Number(headers.get("Morph-Scale") ?? 1);
  const values = new Float32Array(levels.length);
  for (let i = 0; i < levels.length; i += 1) values[i] = offset + scale * levels[i];
  return values;
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return { detail: "The response is not from this service." };
  }
}

function unreachable() {
  return new Problem({
    title: "No answer",
    detail: "The service does not answer.",
    remedy: "Check that the service is running, and try again.",
  });
}
