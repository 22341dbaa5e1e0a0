/** Light or dark: as the system has it, until somebody chooses. */

const PLACE = "morph-theme";
const system = matchMedia("(prefers-color-scheme: dark)");

/** "light" or "dark", whichever is shown. */
export function theme() {
  return localStorage.getItem(PLACE) ?? (system.matches ? "dark" : "light");
}

/** Show what was chosen. */
export function applyTheme() {
  document.documentElement.dataset.theme = theme();
}

/** Choose the other one; drawings hear the event "themechange" of the document. */
export function switchTheme() {
  localStorage.setItem(PLACE, theme() === "dark" ? "light" : "dark");
  changed();
}

function changed() {
  applyTheme();
  document.dispatchEvent(new CustomEvent("themechange"));
}

system.addEventListener("change", changed);
