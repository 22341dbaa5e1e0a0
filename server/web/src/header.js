/** Name, ways to the views, whether the service works, light or dark. */

import { get } from "./api.js";
import { fill, h, svg } from "./dom.js";
import { forgetKey, key, missing } from "./key.js";
import { available, notifies, startNotifying, switchNotifying } from "./notifications.js";
import { poll } from "./polling.js";
import { shared } from "./share_link.js";
import { switchTheme, theme } from "./theme.js";

const MARK = "M9 1.5a7.5 7.5 0 1 0 0 15 7.5 7.5 0 0 0 0-15zM9 9h13.5v13.5H9z";
const SUN = "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2v2M12 20v2M2 12h2M20 12h2M5 5l1.4 1.4M17.6 17.6 19 19M5 19l1.4-1.4M17.6 6.4 19 5";
const MOON = "M20 14.5A8.5 8.5 0 0 1 9.5 4 8.5 8.5 0 1 0 20 14.5z";
const BELL = "M6 17V11a6 6 0 0 1 12 0v6l2 2H4zM10 22h4M12 2v3";
const PAUSE = 10_000; // [ms] between looks at the service

/** Fill the header; that of a shared job leads nowhere else. */
export function header(element) {
  if (shared()) {
    const brand = h("span", { class: "brand" }, drawing(MARK), h("span", null, "morph"));
    fill(element, brand, h("div", { class: "header-end" }, h("span", null, "Shared with you"), themeButton()));
    return;
  }
  const health = h("span", { class: "health" });
  fill(
    element,
    h("a", { class: "brand", href: "/", "aria-label": "morph" }, drawing(MARK), h("span", null, "morph")),
    h(
      "nav",
      { "aria-label": "Main" },
      h("a", { href: "/" }, "Jobs"),
      h("a", { href: "/gallery" }, "Gallery"),
      h("a", { href: "/new" }, "New", h("span", { class: "wide" }, " morph")),
      h("a", { class: "wide", href: "/docs" }, "API"),
    ),
    h("div", { class: "header-end" }, health, keyButton(), notifyButton(), themeButton()),
  );
  const never = new AbortController().signal;
  poll(() => look(health), never, (error) => error && show(health, "bad", "No answer"));
}

async function look(health) {
  const ready = await fetch("/readyz").catch(() => null);
  if (!ready?.ok) {
    show(health, "bad", ready ? "Not ready" : "No answer");
    return PAUSE / 2;
  }
  try {
    const workers = (await get("/workers", { quiet: true })).filter((worker) => worker.alive);
    const busy = workers.filter((worker) => worker.job).length;
    if (workers.length === 0) show(health, "warn", "No workers");
    else {
      const noun = workers.length === 1 ? "worker " : "workers ";
      show(health, "good", `${busy} of ${workers.length}`, h("span", { class: "wide" }, " ", noun, "busy"));
    }
  } catch (error) {
    if (error.status !== 401 && error.status !== 403) throw error;
    show(health, "good", "Ready"); // only an admin sees workers
  }
  return PAUSE;
}

function show(health, kind, ...text) {
  fill(health, h("span", { class: `badge ${kind}` }, h("span", null, text)));
}

function keyButton() {
  const click = () => {
    forgetKey();
    location.reload(); // which asks for one if one is needed
  };
  const button = h("button", { class: "plain compact", type: "button", on: { click } });
  const draw = () => {
    button.hidden = !key() && !missing();
    fill(button, key() ? "Forget key" : "Enter key");
  };
  document.addEventListener("keychange", draw);
  draw();
  return button;
}

function notifyButton() {
  const label = "Notify me when a job ends";
  const click = () => switchNotifying().then(draw);
  const attributes = { class: "plain icon", type: "button", "aria-label": label, title: label };
  const button = h("button", { ...attributes, hidden: !available(), on: { click } }, drawing(BELL));
  const draw = () => button.setAttribute("aria-pressed", String(notifies()));
  draw();
  startNotifying();
  return button;
}

function themeButton() {
  const button = h("button", { class: "plain icon", type: "button", on: { click: switchTheme } });
  const draw = () => {
    const other = theme() === "dark" ? "Light" : "Dark";
    button.setAttribute("aria-label", `${other} colours`);
    button.title = `${other} colours`;
    fill(button, drawing(other === "Light" ? SUN : MOON));
  };
  document.addEventListener("themechange", draw);
  draw();
  return button;
}

function drawing(path) {
  return svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, svg("path", { d: path }));
}
