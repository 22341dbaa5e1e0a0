/** The viewer of a file that needs no service: what it shows is in the file itself. */
import "../styles/tokens.css";
import "../styles/base.css";
import "../viewer/viewer.css";
import "../viewer/stage.css";
import "./standalone.css";

import { fill, h } from "../dom.js";
import { iconButton } from "../icons.js";
import { bindKeys, cameraKeys, showKeys } from "../viewer/keys.js";
import { LOOKS } from "../viewer/looks.js";
import { Timeline } from "../viewer/timeline.js";
import { Viewer } from "../viewer/viewer.js";
import { unpack } from "./film.js";

const text = (id) => document.getElementById(id).textContent;

async function start() {
  const about = JSON.parse(text("about"));
  const film = await unpack(about, text("frames").trim());
  const { signal } = new AbortController();
  const scene = h("div", { class: "scene", tabindex: 0, role: "application", "aria-label": "3D view" });
  const choice = (label, options, change) => {
    const on = { change: (event) => change(event.target.value) };
    return h(
      "select",
      { "aria-label": label, title: label, on },
      options.map(([value, name]) => h("option", { value }, name)),
    );
  };
  let kind = film.surfaces.length ? "surface" : "points";
  let moment = 0;
  const show = (at) => {
    moment = at;
    const { closing } = timeline;
    viewer.setFrame(Math.floor(at), film.positions(at, closing));
    const surface = kind === "surface" ? film.surface(at, closing) : null;
    viewer.setSurface(surface);
    const light = surface ? surface.light : film.light(at, closing);
    if (light && surface) viewer.setSurfaceLight(light);
    else if (light) viewer.setParticleLight(light);
    viewer.draw();
  };
  const choose = (name) => {
    kind = kinds.value = name;
    show(moment);
  };
  const kinds = choice("Show as", [["surface", "Surface"], ["points", "Particles"]], choose);
  const looks = choice("Look", Object.entries(LOOKS).map(([name, { label }]) => [name, label]), (name) => {
    viewer.setLook(name);
    show(moment);
  });
  const timeline = new Timeline({
    signal,
    show: async (index) => show(index),
    between: (share) => show(timeline.index + share),
  });
  const several = film.surfaces.length > 0;
  const toggle = (name) => several && choose(name);
  fill(
    document.getElementById("view"),
    h(
      "section",
      { class: "looking", "aria-label": "Viewer" },
      h(
        "div",
        { class: "stage-top" },
        h("div", { class: "headline floating" }, h("h1", null, about.title), h("p", { class: "small quiet" }, about.words)),
        h(
          "div",
          { class: "tools floating", role: "toolbar", "aria-label": "View" },
          several && kinds,
          looks,
          iconButton("Fit to view", "frame", () => viewer.reset(), { key: "Home" }),
          h("button", { type: "button", class: "icon", "aria-label": "Keys", title: "Keys (?)", on: { click: showKeys } }, "?"),
        ),
      ),
      h("figure", { class: "view" }, h("div", { class: "scene-frame" }, scene)),
      timeline.element,
    ),
  );
  const viewer = new Viewer(scene, { reducedMotion: matchMedia("(prefers-reduced-motion: reduce)").matches });
  viewer.setUp(about.up);
  viewer.setSpacing(about.spacing);
  viewer.setEnds([film.positions(0), film.positions(film.count - 1)]);
  bindKeys(
    {
      ...cameraKeys((move) => viewer.steer(move)),
      " ": () => timeline.toggle.click(),
      ArrowLeft: () => timeline.step(-1),
      ArrowRight: () => timeline.step(1),
      "Shift+ArrowLeft": () => timeline.step(-Infinity),
      "Shift+ArrowRight": () => timeline.step(Infinity),
      Home: () => viewer.reset(),
      0: () => viewer.reset(),
      s: () => toggle("surface"),
      p: () => toggle("points"),
      "?": showKeys,
    },
    { signal },
  );
  timeline.following = false;
  timeline.loop.checked = true;
  if (about.timing) timeline.setPace(about.timing);
  timeline.grow(film.count);
  await timeline.go(0);
  document.body.dataset.ready = "true";
}

start();
