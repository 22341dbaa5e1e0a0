/** The address of the page: going to another, changing its query, and the title it has. */

let show = () => {};
let shown = null;

/** Call a function with each address that is visited from now on, the present one first. */
export function onVisit(callback) {
  show = () => {
    shown = address();
    return callback();
  };
  addEventListener("popstate", () => address() !== shown && show());
  return show();
}

/** Go to an address of the page. */
export function go(path) {
  history.pushState(null, "", path);
  scrollTo(0, 0);
  return show();
}

/** Change the query without leaving the view, as filters do; undefined and "" take a key away. */
export function replaceQuery(query) {
  const search = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) {
    for (const one of [value].flat()) if (one) search.append(name, one);
  }
  try {
    history.replaceState(null, "", location.pathname + (search.size ? `?${search}` : "") + location.hash);
  } catch (error) {
    if (error.name !== "SecurityError") throw error; // Safari takes a hundred in a while; a later one goes there
  }
  shown = address();
}

/** A value of the query; null where there is none. */
export function query(name) {
  return new URLSearchParams(location.search).get(name);
}

/** Change one value of the query without leaving the view; null takes it away. */
export function setQuery(name, value) {
  replaceQuery({ ...Object.fromEntries(new URLSearchParams(location.search)), [name]: value });
}

/** Set the title of the document, of which each view gives a part. */
export function setTitle(text) {
  document.title = text ? `${text} · morph` : "morph";
}

function address() {
  return location.pathname + location.search;
}
