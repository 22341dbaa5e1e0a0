/** Addresses to views. A view module exports `async show(root, params, signal)`. */

import { Problem } from "./api.js";
import { fill, h } from "./dom.js";
import { askAgain } from "./key.js";
import { go, onVisit, setTitle } from "./navigation.js";
import { part } from "./part.js";
import { problemNotice } from "./problem_notice.js";

// on its way together with the view that will ask for it
const scene = () => import("./viewer/viewer.js").catch(() => {});

const ROUTES = [
  [/^\/$/, [], () => import("./views/jobs/jobs.js")],
  [/^\/new$/, [], () => import("./views/new/new.js")],
  [/^\/jobs\/([^/]+)$/, ["id"], () => (scene(), import("./views/job/job.js"))],
  [/^\/shared\/([^/]+)$/, ["id"], () => (scene(), import("./views/job/job.js"))],
  [/^\/gallery$/, [], () => import("./views/gallery/gallery.js")],
  [/^\/compare$/, [], () => (scene(), import("./views/compare/compare.js"))],
];

let root;
let leaving = new AbortController();
let first = true;

/** Show views in an element from now on, the one of the present address first. */
export function start(element) {
  root = element;
  document.addEventListener("click", (event) => {
    const link = event.target.closest?.("a[href]");
    if (!link || event.defaultPrevented || !ours(link, event)) return;
    event.preventDefault();
    go(link.pathname + link.search);
  });
  return onVisit(show);
}

async function show() {
  leaving.abort();
  askAgain();
  leaving = new AbortController();
  const { signal } = leaving;
  const moved = !first;
  first = false;
  const query = Object.fromEntries(new URLSearchParams(location.search));
  for (const link of document.querySelectorAll("header nav a")) {
    if (link.pathname === location.pathname) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  try {
    const [params, load] = find(location.pathname);
    if (!load) return notFound();
    const view = await part(load);
    if (signal.aborted) return;
    fill(root);
    if (moved) root.focus({ preventScroll: true });
    await view.show(root, { ...query, ...params }, signal);
  } catch (error) {
    if (signal.aborted || error.name === "AbortError") return;
    fill(root, problemNotice(error));
    if (!(error instanceof Problem)) throw error;
  }
}

function find(path) {
  for (const [pattern, names, load] of ROUTES) {
    const match = pattern.exec(path);
    if (match) {
      return [Object.fromEntries(names.map((n, i) => [n, decodeURIComponent(match[i + 1])])), load];
    }
  }
  return [{}, null];
}

function ours(link, event) {
  const plain = event.button === 0 && !(event.metaKey || event.ctrlKey || event.shiftKey);
  const here = link.origin === location.origin && !link.target && !link.hasAttribute("download");
  return plain && here && !link.getAttribute("href").startsWith("#") && find(link.pathname)[1];
}

function notFound() {
  setTitle("Not found");
  fill(
    root,
    h("h1", null, "There is nothing here"),
    h("p", null, h("a", { href: "/" }, "All jobs")),
  );
}
