/** One job: its shape in 3D over time, its curves, what happened, its settings and files. */
import "../../charts/charts.css";
import "./job.css";

import { announce } from "../../announce.js";
import { Problem, get } from "../../api.js";
import { Curves } from "../../charts/curves.js";
import { fill, h } from "../../dom.js";
import { jobFileName, jobName, lives, state as word } from "../../format.js";
import { go, query, setQuery, setTitle } from "../../navigation.js";
import { problemNotice } from "../../problem_notice.js";
import { shared } from "../../share_link.js";
import { Display } from "../../viewer/display.js";
import { Pace } from "../../viewer/pace.js";
import { Panel } from "../../viewer/panel.js";
import { stage } from "../../viewer/stage.js";
import { Timeline } from "../../viewer/timeline.js";
import { Downloads } from "./downloads.js";
import { inGridUnits } from "../../viewer/landmarks.js";
import { History } from "./history.js";
import { landmarks } from "./landmarks.js";
import { pictures } from "./pictures.js";
import { settings } from "./settings.js";
import { Sharing } from "./sharing.js";
import { Summary } from "./summary.js";
import { Watch } from "./watch.js";

const FRAME = "frame"; // in the address: the one shown, from 1
const QUIET_MILLISECONDS = 300; // after which a frame that one stays at goes into the address

/** Show the job with the id of the address. */
export async function show(root, { id }, signal) {
  setTitle("Job");
  const ending = new AbortController(); // when the job has gone
  const there = AbortSignal.any([signal, ending.signal]);
  const display = new Display({ onChange: (state) => panel.setDisplay(state) });
  const onQuality = (names) => display.tell(names);
  const onOwn = () => display.offerOwn();
  const panel = new Panel(id, { signal: there, display: display.state, onQuality, onOwn });
  const curves = new Curves({ onSeek: (index) => timeline.choose(index), signal: there });
  let resting = 0;
  const timeline = new Timeline({
    signal: there,
    show: (index, how) => {
      curves.setFrame(index);
      return panel.show(index, how);
    },
    between: (share) => panel.between(share),
    onRest: (index) => {
      clearTimeout(resting);
      resting = setTimeout(() => signal.aborted || setQuery(FRAME, index === null ? null : index + 1), QUIET_MILLISECONDS);
    },
  });
  const pace = new Pace({ jobId: id, timeline, signal: there });
  display.element.append(pace.element);
  const summary = new Summary({ changed: () => changed(), signal });
  summary.figures.after(panel.surfaceWords);
  const sharing = shared() ? null : new Sharing({ jobId: id, signal });
  const history = new History();
  const downloads = new Downloads({ jobId: id, panel, timeline, pace, signal });
  const rows = new Map();
  panel.metrics = (index) => rows.get(index) ?? null;

  /** The frame of the address, or the first one of what is done already; else the newest, whichever that is. */
  const begin = ({ state, progress }) => {
    if (!progress.frame || (lives(state) && !query(FRAME))) return;
    const index = Math.min(Math.max(Number(query(FRAME)) || 1, 1), progress.frame) - 1;
    timeline.following = false;
    panel.frames.look(index);
    grow(progress.frame);
    timeline.go(index);
  };
  let config = null;
  const showShape = (job) => {
    if (config && !shared() && lives(job.state) && !job.progress.frame) panel.showShape(job, config);
  };
  let known = null;
  const onJob = (job) => {
    setTitle(jobName(job));
    if (known === null) begin(job);
    display.stand(job);
    if (known && known !== job.state) announce(`The job is ${word(job.state).toLowerCase()}.`);
    known = job.state;
    summary.update(job);
    downloads.update(job);
    pace.offer(job);
    panel.grows = lives(job.state);
    history.set({ job });
    panel.plan(job);
    if (["preparing", "computing"].includes(job.progress.stage)) panel.showSource();
    if (job.progress.frame === 0 && panel.frames.known) onAnew();
    showShape(job);
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

  const asked = get(`/jobs/${id}/config`, { signal });
  asked.catch(() => {}); // told of below
  const job = await watch.ask();
  const name = () => jobFileName(watch.job);
  const aside = h("div", { class: "stack" });
  const sheets = [
    { name: "overview", title: "Overview", content: [summary.element, sharing?.element, history.element] },
    {
      name: "curves",
      title: "Curves",
      content: [h("h2", { class: "visually-hidden" }, "Curves"), curves.element],
    },
    { name: "settings", title: "Settings", content: [aside] },
    { name: "files", title: "Files", content: [pictures({ panel, timeline, name, signal }), downloads.element] },
  ];
  const frameAll = async () => (await panel.viewer)?.reset();
  fill(
    root,
    stage({ headline: summary.headline, views: panel.element, panel, frameAll, display, timeline, sheets, signal: there }),
  );
  watch.run().catch(gone);
  try {
    config = await asked;
    showShape(watch.job);
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    aside.append(problemNotice(error));
  }
  panel.open();
  if (!config) return;
  panel.setConfig(config);
  const marked = inGridUnits(job, config);
  if (marked.length) {
    const list = landmarks(marked);
    history.element.before(list.element);
    panel.setLandmarks(marked, list.show);
  }
  aside.append(settings(job, config, signal));
}
