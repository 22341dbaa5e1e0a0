/** The share link by which the page was opened: its secret reads the one job of the address, and nothing else. */

const ADDRESS = /^\/shared\/([^/]+)$/;
const SECRET = /^#(share_.+)$/;

/** Whether what is shown was shared by a link, and is for reading alone. */
export function shared() {
  return ADDRESS.test(location.pathname);
}

/** The secret of the link; it stays with the tab, since what is after the # changes when one skips to the content. */
export function sharedSecret() {
  const place = `morph-share ${ADDRESS.exec(location.pathname)[1]}`;
  const given = SECRET.exec(location.hash)?.[1];
  if (given) sessionStorage.setItem(place, given);
  return given ?? sessionStorage.getItem(place) ?? "";
}

/** Another link to the same job, put into the address, is no visit of its own. */
addEventListener("hashchange", () => shared() && SECRET.test(location.hash) && location.reload());
