/** All jobs: where they stand, what may be done with them, and which to compare. */

import { announce } from "../../announce.js";
import { get, post } from "../../api.js";
import { fill, h } from "../../dom.js";
import { jobName, lives, state as stateWord } from "../../format.js";
import { freshKey } from "../../idempotency.js";
import { poll } from "../../polling.js";
import { go, replaceQuery, setTitle } from "../../navigation.js";
import { released } from "../../press.js";
import { problemNotice } from "../../problem_notice.js";
import { Filters } from "./filters.js";
import { Queue } from "./queue.js";
import { Row } from "./row.js";
import { Selection } from "./selection.js";
import "./jobs.css";

const PAGE = 20;
const QUICK = 2000; // [ms] between looks while something moves
const SLOW = 10_000;
const POSITIONS = 8; // waiting jobs whose place in the queue is asked for, each by a request

const FIRST = {
  source: { shape: "sphere" },
  target: { shape: "star" },
  preset: "fast",
  frames: 30,
  name: "",
};

export async function show(root, params, signal) {
  setTitle("Jobs");
  const list = new JobList(params, signal);
  fill(root, list.element);
  await list.run();
}

class JobList {
  constructor(params, signal) {
    this.params = params;
    this.signal = signal;
    this.rows = new Map();
    this.selection = new Selection();
    this.queue = new Queue(() => this.refresh(), signal);
    this.trouble = h("div");
    this.body = h("tbody", { role: "rowgroup" });
    this.content = h("div", { class: "stack" });
    this.paging = h("nav", { class: "row paging", "aria-label": "Pages" });
    this.asked = 0;
    this.element = h(
      "div",
      { class: "stack jobs" },
      h(
        "div",
        { class: "spread" },
        h("h1", null, "Jobs"),
        h("a", { class: "button primary", href: "/new" }, "New morph"),
      ),
      new Filters(params, (wanted) => this.filter(wanted)).element,
      this.queue.element,
      this.trouble,
      this.content,
      this.paging,
      this.selection.element,
    );
    this.table = table(this.body);
  }

  run() {
    return poll(
      () => this.refresh(),
      this.signal,
      (error) => fill(this.trouble, error && problemNotice(error)),
    );
  }

  async refresh() {
    const { state, method, sweep, cursor } = this.params;
    const asked = (this.asked += 1);
    const page = await get("/jobs", {
      query: { state: state?.split(","), method, sweep, cursor, limit: PAGE },
      signal: this.signal,
    });
    await Promise.all([this.addPositions(page.items), this.queue.refresh()]);
    await released();
    if (asked === this.asked) {
      this.draw(page);
      fill(this.trouble);
    } // else another answer is on its way
    return page.items.some((job) => lives(job.state)) ? QUICK : SLOW;
  }

  /** List other jobs, from the newest on. */
  filter(wanted) {
    this.params = wanted;
    this.nothing = null;
    replaceQuery(wanted);
    this.refresh().catch((error) => fill(this.trouble, problemNotice(error)));
  }

  /** The list leaves out places in the queue; those of the jobs next in turn are worth a look. */
  async addPositions(jobs) {
    const waiting = jobs.filter((job) => job.state === "queued").slice(-POSITIONS);
    await Promise.all(
      waiting.map(async (job) => {
        const alone = await get(`/jobs/${job.id}`, { signal: this.signal }).catch(() => null);
        if (alone) Object.assign(job, alone);
      }),
    );
  }

  draw({ items, next_cursor: next }) {
    const shown = new Set(items.map((job) => job.id));
    for (const [id, row] of this.rows) {
      if (shown.has(id)) continue;
      row.element.remove();
      row.dispose();
      this.rows.delete(id);
      this.selection.drop(id);
    }
    items.forEach((job, index) => {
      let row = this.rows.get(job.id);
      if (!row) {
        row = new Row(job, { selection: this.selection, changed: () => this.refresh() });
        this.signal.addEventListener("abort", () => row.dispose(), { once: true });
        this.rows.set(job.id, row);
      } else if (row.job.state !== job.state) {
        announce(`${jobName(job)}: ${stateWord(job.state)}.`);
      }
      row.update(job);
      if (this.body.children[index] !== row.element) {
        this.body.insertBefore(row.element, this.body.children[index] ?? null);
      }
    });
    const content = items.length ? this.table : this.empty();
    if (this.content.firstChild !== content) fill(this.content, content);
    this.page(next);
  }

  page(next) {
    const { state, method, sweep, cursor } = this.params;
    const to = (wanted) => {
      const query = new URLSearchParams();
      for (const [name, value] of Object.entries({ state, method, sweep, cursor: wanted })) {
        if (value) query.set(name, value);
      }
      return `/${query.size ? `?${query}` : ""}`;
    };
    const key = JSON.stringify([cursor && to(null), next && to(next)]);
    if (this.paged === key) return; // a link that has the focus stays
    this.paged = key;
    fill(
      this.paging,
      cursor && h("a", { class: "button", href: to(null) }, "Newest"),
      next && h("a", { class: "button", href: to(next) }, "Older"),
    );
  }

  empty() {
    const { state, method, sweep, cursor } = this.params;
    if (this.nothing) return this.nothing;
    this.nothing =
      state || method || sweep || cursor
        ? h(
            "div",
            { class: "panel empty" },
            h("p", null, "No jobs match."),
            h("a", { class: "button", href: "/" }, "Show all jobs"),
          )
        : this.invitation();
    return this.nothing;
  }

  invitation() {
    const trouble = h("div");
    const key = freshKey();
    const begin = async (event) => {
      event.currentTarget.disabled = true;
      try {
        const job = await post("/jobs", FIRST, { idempotencyKey: key });
        go(`/jobs/${job.id}`);
      } catch (error) {
        fill(trouble, problemNotice(error));
        event.target.disabled = false;
      }
    };
    return h(
      "div",
      { class: "panel empty" },
      h("h2", null, "Nothing has been morphed yet"),
      h(
        "p",
        { class: "quiet" },
        "A morph moves the particles of one shape into another by physics. ",
        "The first one takes less than a minute.",
      ),
      h(
        "div",
        { class: "row" },
        h("button", { class: "primary", on: { click: begin } }, "Morph a sphere into a star"),
        h("a", { class: "button", href: "/new" }, "Choose the shapes"),
      ),
      trouble,
    );
  }
}

function table(body) {
  const head = (text, attributes) => h("th", { scope: "col", role: "columnheader", ...attributes }, text);
  return h(
    "table",
    { class: "job-table", role: "table", "aria-label": "Jobs" },
    h(
      "thead",
      { role: "rowgroup" },
      h(
        "tr",
        { role: "row" },
        head(h("span", { class: "visually-hidden" }, "Compare")),
        head(h("span", { class: "visually-hidden" }, "Picture")),
        head("Morph"),
        head("State"),
        head("Progress"),
        head(h("abbr", { title: "How much of the target is filled at the end" }, "Filled"), {
          class: "number",
        }),
        head(h("span", { class: "visually-hidden" }, "Actions")),
      ),
    ),
    body,
  );
}
