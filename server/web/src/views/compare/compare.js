/** Two to four jobs side by side: one camera, one time, one scale of colours. */
import "../../charts/charts.css";
import "./compare.css";

import { get } from "../../api.js";
import { fill, h } from "../../dom.js";
import { jobName, lives, state as word } from "../../format.js";
import { setTitle } from "../../navigation.js";
import { problemNotice } from "../../problem_notice.js";
import { COLOURS } from "../../viewer/colors.js";
import { watchCovered } from "../../viewer/covered.js";
import { Display } from "../../viewer/display.js";
import { Panel } from "../../viewer/panel.js";
import { stage } from "../../viewer/stage.js";
import { Timeline } from "../../viewer/timeline.js";
import { follow } from "./follow.js";
import { Links } from "./links.js";
import { MAX_COMPARED } from "./max_compared.js";
import { Overlay } from "./overlay.js";
import { table } from "./table.js";


/** Show the jobs that the query names, `?jobs=a,b`. */
export async function show(root, { jobs: wanted = "" }, signal) {
  setTitle("Compare");
  const ids = [...new Set(wanted.split(",").filter(Boolean))].slice(0, MAX_COMPARED);
  if (ids.length < 2) {
    fill(
      root,
      h("h1", null, "Compare"),
      h("p", null, "Choose two to four jobs in the ", h("a", { href: "/" }, "list of jobs"), "."),
    );
    return;
  }
  const jobs = await Promise.all(ids.map((id) => get(`/jobs/${id}`, { signal })));
  const rows = ids.map(() => []);
  const links = new Links();
  const display = new Display({
    open: false,
    onChange: async (state) => {
      const turned = links.panels.some((panel) => panel.display.up !== state.up);
      await Promise.all(links.panels.map((panel) => panel.setDisplay(state)));
      if (turned) await links.reset();
    },
  });
  display.stand(jobs[0]);
  const overlay = new Overlay({ onSeek: (index) => timeline.choose(index), signal });
  const panels = ids.map((id, i) => {
    const panel = new Panel(id, {
      signal,
      display: display.state,
      onView: (view) => links.look(panel, view),
      onQuality: (names) => display.tell(names),
      onOwn: () => display.offerOwn(),
      sharedRange: () => links.range(),
      share: 1 / ids.length,
      onArrival: () => settle(),
      onEnds: () => links.refit(),
    });
    panel.metrics = (index) => rows[i][index] ?? null;
    panel.plan(jobs[i]);
    panel.grows = lives(jobs[i].state);
    panel.frames.grow(jobs[i].progress.frame);
    panel.open();
    return links.add(panel);
  });
  const timeline = new Timeline({
    signal,
    show: async (index, how) => {
      overlay.setFrame(index);
      await Promise.all(panels.map((panel) => showIn(panel, index, how)));
    },
    between: (share) => {
      for (const panel of panels) if (panel.index === timeline.index) panel.between(share);
    },
  });
  const showIn = (panel, index, how) => {
    const { known } = panel.frames;
    return known > 0 && index >= 0 ? panel.show(Math.min(index, known - 1), how) : null;
  };
  const differences = h("div");
  const heads = jobs.map(() => h("div", { class: "compare-head floating" }));
  const views = h(
    "div",
    { class: `compare-views of-${ids.length}` },
    panels.map((panel, i) =>
      h("section", { "aria-label": jobName(jobs[i]) }, h("div", { class: "compare-top" }, heads[i]), panel.element),
    ),
  );
  panels.forEach((panel, i) => {
    const bars = [heads[i].parentElement, panel.legend.element, panel.caption];
    watchCovered(panel, bars.map((bar) => [bar]), signal, () => links.refit());
  });
  const metrics = [
    h("h2", null, "Metrics"),
    h("p", { class: "quiet small" }, "Differences are relative to the first job; the best value in each row is bold."),
    differences,
    h(
      "dl",
      { class: "stack small" },
      panels.map((panel, i) =>
        h("div", null, h("dt", null, h("i", { class: `swatch series-${i + 1}` }), jobName(jobs[i])), h("dd", null, panel.surfaceWords)),
      ),
    ),
  ];
  const sheets = [
    { name: "metrics", title: "Metrics", content: metrics },
    { name: "curves", title: "Curves", content: [h("h2", { class: "visually-hidden" }, "Curves"), overlay.element] },
  ];
  fill(
    root,
    stage({
      headline: h("h1", { class: "visually-hidden" }, "Compare"),
      views,
      panel: panels[0],
      frameAll: () => links.reset(),
      display,
      timeline,
      sheets,
      signal,
    }),
  );

  const draw = () => {
    fill(differences, table(jobs));
    overlay.set(jobs, rows);
    overlay.setFrame(timeline.index);
    jobs.forEach((job, i) => {
      head(heads[i], job, i);
      panels[i].grows = lives(job.state);
    });
    const longest = Math.max(...panels.map((panel) => panel.frames.known));
    timeline.grow(longest, jobs.some((job) => lives(job.state)));
  };
  let settling = 0;
  let settled = 0; // panels that were there when the cameras were joined last
  const settle = () => {
    clearTimeout(settling);
    settling = setTimeout(async () => {
      if (signal.aborted) return;
      const there = panels.filter((panel) => panel.frames.known > 0);
      const joining = there.length > settled;
      if (joining || COLOURS[display.state.colour]?.local) await links.recolour();
      if (joining && there.every((panel) => panel.index >= 0)) {
        settled = there.length;
        await links.reset();
      }
    }, 150);
  };
  signal.addEventListener("abort", () => clearTimeout(settling), { once: true });
  ids.forEach((id, i) => {
    get(`/jobs/${id}/config`, { signal })
      .then((config) => panels[i].setConfig(config))
      .catch(() => {});
    follow(id, signal, (job, found) => {
      jobs[i] = job;
      rows[i] = found;
      panels[i].plan(job);
      const before = panels[i].frames.known;
      panels[i].frames.grow(Math.max(job.progress.frame, found.length));
      const index = timeline.index;
      draw();
      const more = panels[i].frames.known > before && index === timeline.index;
      if (more && index > panels[i].index) showIn(panels[i], index);
      panels[i].describe();
    }).catch((error) => signal.aborted || fill(heads[i], problemNotice(error)));
  });
}

function head(element, job, i) {
  const key = JSON.stringify([job.state, job.progress.frame]);
  if (element.dataset.shown === key) return;
  element.dataset.shown = key;
  const focused = element.contains(document.activeElement);
  fill(
    element,
    h(
      "h2",
      null,
      h("i", { class: `swatch series-${i + 1}` }),
      h("a", { href: `/jobs/${job.id}` }, jobName(job)),
    ),
    h(
      "p",
      { class: "small quiet row" },
      h("span", { class: `badge ${job.state}` }, word(job.state)),
      h("span", { class: "method" }, `method ${job.method}`),
    ),
  );
  if (focused) element.querySelector("a").focus();
}
