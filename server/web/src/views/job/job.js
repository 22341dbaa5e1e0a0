/** One job: its shape in 3D over time, its curves, what happened, its settings and files. */
import "../../viewer/viewer.css";
import "../../charts/charts.css";
import "./job.css";

import { announce } from "../../announce.js";
import { Problem, get } from "../../api.js";
import { Curves } from "../../charts/curves.js";
import { fill, h } from "../../dom.js";
import { jobFileName, jobName, lives, state as word } from "../../format.js";
import { go, setTitle } from "../../navigation.js";
import { problemNotice } from "../../problem_notice.js";
import { Display } from "../../viewer/display.js";
import { Panel } from "../../viewer/panel.js";
import { Timeline } from "../../viewer/timeline.js";
import { Downloads } from "./downloads.js";
import { History } from "./history.js";
import { pictures } from "./pictures.js";
import { settings } from "./settings.js";
import { Summary } from "./summary.js";
import { Watch } from "./watch.js";

/** Show the job with the id of the address. */
export async function show(root, { id }, signal) {
  setTitle("Job");
  const ending = new AbortController(); // when the job has gone
  const there = AbortSignal.any([signal, ending.signal]);
  const display = new Display({ onChange: (state) => panel.setDisplay(state) });
  const panel = new Panel(id, { signal: there, display: display.state });
  const curves = new Curves({ onSeek: (index) => timeline.choose(index), signal: there });
  const timeline = new Timeline({
    signal: there,
    show: (index) => {
      curves.setFrame(index);
      return panel.show(index);
    },
  });
  const summary = new Summary({ changed: () => changed(), signal });
  const history = new History();
  const downloads = new Downloads({ jobId: id, frame: () => Math.max(timeline.index, 0), signal });
  const rows = new Map();
  panel.metrics = (index) => rows.get(index) ?? null;

  let known = null;
  const onJob = (job) => {
    setTitle(jobName(job));
    if (known && known !== job.state) announce(`The job is ${word(job.state).toLowerCase()}.`);
    known = job.state;
    summary.update(job);
    downloads.update(job);
    history.set({ job });
    panel.total = job.progress.frames;
    if (["preparing", "computing"].includes(job.progress.stage)) panel.showSource();
    if (job.progress.frame === 0 && panel.frames.known) onAnew();
    grow(job.progress.frame);
  };
  const grow = (count) => {
    panel.frames.grow(count);
    timeline.grow(panel.frames.known, lives(watch.job.state));
  };
  const onRows = (all) => {
    rows.clear();
    for (const row of all) rows.set(row.frame, row);
    curves.setRows(all);
    grow(all.length ? all.at(-1).frame + 1 : 0);
    panel.describe();
  };
  const onAnew = () => {
    panel.clear();
    rows.clear();
    curves.setRows([]);
    timeline.following = true;
    timeline.grow(0, true);
    panel.describe();
  };
  const changed = async () => {
    try {
      await watch.changed();
    } catch (error) {
      if (error.status === 404) go("/"); // it was deleted here
      else gone(error);
    }
  };
  const gone = (error) => {
    if (signal.aborted) return;
    ending.abort();
    fill(root, problemNotice(error));
  };
  const watch = new Watch(id, signal, {
    onJob,
    onRows,
    onAnew,
    onEvents: (events) => {
      history.set({ events });
      if (events.at(-1)?.type === "stage" && lives(watch.job.state)) watch.ask().catch(() => {});
    },
    onConnection: (there) => summary.connection(there),
  });

  const job = await watch.ask();
  panel.open();
  const name = () => jobFileName(watch.job);
  const aside = h("div", { class: "stack" });
  fill(
    root,
    h(
      "div",
      { class: "job stack" },
      summary.element,
      h(
        "div",
        { class: "job-main" },
        h(
          "section",
          { class: "stack looking", "aria-label": "Viewer" },
          panel.element,
          timeline.element,
          display.element,
          pictures({ panel, timeline, name, signal }),
        ),
        h("section", { class: "stack", "aria-labelledby": "curves" }, h("h2", { id: "curves" }, "Curves"), curves.element),
      ),
      h("div", { class: "job-more" }, h("div", { class: "stack" }, downloads.element, history.element), aside),
    ),
  );
  watch.run().catch(gone);
  try {
    const config = await get(`/jobs/${id}/config`, { signal });
    panel.setConfig(config);
    aside.append(settings(job, config, signal));
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    aside.append(problemNotice(error));
  }
}
