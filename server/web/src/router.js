/** Addresses to views. A view module exports `async show(root, params, signal)`. */

import { Problem } from "./api.js";
import { fill, h } from "./dom.js";
import { askAgain } from "./key.js";

// on its way together with the view that will ask for it
const scene = () => import("./viewer/viewer.js").catch(() => {});

const ROUTES = [
  [/^\/$/, [], () => import("./views/jobs/jobs.js")],
  [/^\/new$/, [], () => import("./views/new/new.js")],
  [/^\/jobs\/([^/]+)$/, ["id"], () => (scene(), import("./views/job/job.js"))],
  [/^\/compare$/, [], () => (scene(), import("./views/compare/compare.js"))],
];

let root;
let leaving = new AbortController();
let shown = null;

/** Show views in an element from now on, the one of the present address first. */
export function start(element) {
  root = element;
  addEventListener("popstate", () => location.pathname + location.search !== shown && show());
  document.addEventListener("click", (event) => {
    const link = event.target.closest?.("a[href]");
    if (!link || event.defaultPrevented || !ours(link, event)) return;
    event.preventDefault();
    go(link.pathname + link.search);
  });
  return show();
}

/** Go to an address of the page. */
export function go(path) {
  history.pushState(null, "", path);
  scrollTo(0, 0);
  return show();
}

/** Change the query without leaving the view, as filters do; undefined and "" take a key away. */
export function keep(query) {
  const search = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) {
    for (const one of [value].flat()) if (one) search.append(name, one);
  }
  history.replaceState(null, "", location.pathname + (search.size ? `?${search}` : ""));
  shown = location.pathname + location.search;
}

/** The title of the document, of which each view is a part. */
export function title(text) {
  document.title = text ? `${text} · morph` : "morph";
}

async function show() {
  leaving.abort();
  askAgain();
  leaving = new AbortController();
  const { signal } = leaving;
  const first = shown === null;
  shown = location.pathname + location.search;
  const query = Object.fromEntries(new URLSearchParams(location.search));
  for (const link of document.querySelectorAll("header nav a")) {
    if (link.pathname === location.pathname) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  try {
    const [params, load] = find(location.pathname);
    if (!load) return notFound();
    const view = await load();
    if (signal.aborted) return;
    fill(root);
    if (!first) root.focus({ preventScroll: true });
    await view.show(root, { ...query, ...params }, signal);
  } catch (error) {
    if (signal.aborted || error.name === "AbortError") return;
    fill(root, problem(error));
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
  title("Not found");
  fill(
    root,
    h("h1", null, "There is nothing here"),
    h("p", null, h("a", { href: "/" }, "All jobs")),
  );
}

/** A problem as a block that says what is wrong and what to do about it. */
export function problem(error) {
  return h(
    "div",
    { class: "notice bad", role: "alert" },
    h("p", null, error.message),
    error.remedy && h("p", { class: "quiet" }, error.remedy),
  );
}
