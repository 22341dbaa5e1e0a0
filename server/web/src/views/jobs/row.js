/** One job of the list. */

import { picture } from "../../api.js";
import { fill, h, redraw, svg } from "../../dom.js";
import { ago, duration, jobName, percent, plural, state as stateWord } from "../../format.js";
import { inTitles } from "../../problem_notice.js";
import { actions } from "./actions.js";

const PICTURE_PAUSE = 3000; // [ms] at least between two pictures of a job that runs

/** A row of the table that changes with its job and keeps the focus where it is. */
export class Row {
  constructor(job, { selection, changed }) {
    this.job = job;
    this.selection = selection;
    this.changed = changed;
    this.pictured = { frame: -1, at: 0, url: "" };
    this.cells = {
      picture: h("a", { class: "thumbnail", href: `/jobs/${job.id}`, tabindex: "-1", "aria-hidden": "true" }, blank()),
      name: h("td", { role: "cell", class: "name" }),
      state: h("td", { role: "cell", class: "state" }),
      progress: h("td", { role: "cell", class: "progress" }),
      quality: h("td", { role: "cell", class: "number quality" }),
      actions: h("td", { role: "cell", class: "job-actions" }),
    };
    this.element = h(
      "tr",
      { role: "row", data: { job: job.id } },
      h("td", { role: "cell", class: "select" }, selection.box(job)),
      h("td", { role: "cell", class: "picture" }, this.cells.picture),
      this.cells.name,
      this.cells.state,
      this.cells.progress,
      this.cells.quality,
      this.cells.actions,
    );
    this.drawn = {};
  }

  /** Show a job as it is now. */
  update(job) {
    this.job = job;
    this.draw("name", [jobName(job), ago(job.created_at)], () => name(job));
    this.draw("state", [job.state], () =>
      h("span", { class: `badge ${job.state}` }, stateWord(job.state)),
    );
    this.draw("progress", [job.state, job.progress, job.queue_position, job.paused], () => progress(job));
    const filled = job.outcome?.metrics.cover;
    this.draw("quality", [filled], () =>
      Number.isFinite(filled)
        ? [percent(filled), h("span", { class: "label" }, " filled")]
        : h("span", { class: "quiet" }, "–"),
    );
    this.draw("actions", [job.state], () => actions(job, this.changed));
    this.drawPicture();
  }

  /** Let go of the picture. */
  dispose() {
    this.disposed = true;
    URL.revokeObjectURL(this.pictured.url);
  }

  draw(cell, from, make) {
    redraw(this.drawn, cell, this.cells[cell], from, make);
  }

  async drawPicture() {
    const { frame } = this.job.progress;
    const recent = Date.now() - this.pictured.at < PICTURE_PAUSE;
    if (frame < 1 || frame === this.pictured.frame || (recent && this.job.state === "running")) {
      return;
    }
    Object.assign(this.pictured, { frame, at: Date.now() });
    try {
      const url = await picture(`/jobs/${this.job.id}/thumbnail`);
      if (this.disposed) return URL.revokeObjectURL(url);
      URL.revokeObjectURL(this.pictured.url);
      this.pictured.url = url;
      fill(this.cells.picture, h("img", { src: url, alt: "", width: 96, height: 72 }));
    } catch (error) {
      if (error.name !== "Problem") throw error;
      this.pictured.frame = -1; // without a picture the row is still whole, and asks again
    }
  }
}

function blank() {
  return svg(
    "svg",
    { viewBox: "0 0 96 72", class: "blank" },
    svg("circle", { cx: 42, cy: 34, r: 15 }),
    svg("path", { d: "M42 34h22v22H42z" }),
  );
}

function name(job) {
  const facts = [job.method, job.preset, ago(job.created_at), job.owner && `by ${job.owner}`];
  return [
    h("a", { href: `/jobs/${job.id}` }, jobName(job)),
    h(
      "p",
      { class: "quiet small" },
      facts.filter(Boolean).join(" · "),
      job.sweep && [" · ", h("a", { href: `/?sweep=${job.sweep}` }, "sweep")],
    ),
  ];
}

function progress(job) {
  const { frame, frames, seconds_left: left } = job.progress;
  if (job.state === "queued") {
    const waits = job.paused ? ["Paused"] : [place(job.queue_position), remaining(left)];
    return h("p", { class: "small" }, waits.filter(Boolean).join(", "));
  }
  if (job.state === "running") {
    const done = `${frame} of ${plural(frames, "frame")}`;
    return [
      h("progress", { max: frames, value: frame, "aria-label": `Progress of ${jobName(job)}` }),
      h("p", { class: "small" }, [done, remaining(left)].filter(Boolean).join(", ")),
    ];
  }
  if (job.state === "succeeded") {
    const seconds = (new Date(job.finished_at) - new Date(job.started_at)) / 1000;
    return h("p", { class: "small" }, `${plural(frame, "frame")} in ${duration(seconds)}`);
  }
  return [
    h("p", { class: "small" }, `${frame} of ${plural(frames, "frame")}`),
    job.problem && h("p", { class: "small cause" }, inTitles(job.problem.cause)),
  ];
}

function place(position) {
  if (position === null || position === undefined) return "Waiting";
  return position === 0 ? "Next in the queue" : `${plural(position, "job")} before it`;
}

function remaining(seconds) {
  return Number.isFinite(seconds) ? `about ${duration(seconds)} left` : null;
}
