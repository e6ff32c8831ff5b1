// Choose a scenario, run it, and watch which robot does what and when.

import { request } from "./connection.js";
import { el, formatSeconds, setText } from "./dom.js";
import { describeRange, parameterField } from "./fields.js";
import { FleetMap } from "./map.js";
import { PlansPanel } from "./plans.js";
import { store } from "./store.js";
import { Timeline } from "./timeline.js";

/** @import { Field, Parameter, RunEvent, ScenarioEntry, StartedRun, Value, View } from "./types" */

const MAX_NOTES = 200;
/** @type {[string, string][]} */
const CONTROLS = [
  ["pause", "Pause"],
  ["resume", "Continue"],
  ["step", "One step"],
  ["abort", "Abort"],
];
/** @type {Record<string, [string, string]>} Texts and tones. */
const OUTCOMES = { done: ["✓ Done", "good"], failed: ["✕ Failed", "bad"], aborted: ["■ Aborted", "warn"] };
/** @type {string | null} */
let lastFile = null;

/** @param {HTMLElement} root @returns {View} */
export function scenarioView(root) {
  const form = new ScenarioForm();
  const plans = new PlansPanel();
  const status = new RunStatus();
  const canvas = el("canvas", { role: "img", "aria-label": "Timeline of the run" });
  const frame = el("div", { class: "panel timeline", tabIndex: 0 }, canvas);
  const replay = el("iframe", { class: "panel replay", title: "Replay of the run", hidden: true });
  replay.setAttribute("sandbox", "allow-scripts");
  const map = new FleetMap();
  const place = el("div", { class: "run-map", hidden: true }, map.node);
  const notes = el("ul", { class: "notes small", "aria-label": "Events of the run" });
  const heading = el("h2", {}, "Events ", el("span", { class: "faint small" }, "fleet time since the start"));
  const notesPanel = el("div", { class: "panel stack" }, heading, notes);
  root.append(
    el("h1", {}, "Scenario"),
    el(
      "div",
      { class: "split" },
      form.node,
      el("div", { class: "stack" }, plans.node, status.node, frame, replay, notesPanel, place),
    ),
  );
  map.observe();
  let timeline = new Timeline();
  /** @type {RunEvent | undefined} */
  let first;

  function showRun() {
    const source = store.run.phase !== "none" && store.run.report ? `${store.run.report}#replay` : "";
    frame.hidden = store.run.phase === "none" || source !== "";
    replay.hidden = !source;
    place.hidden = frame.hidden;
    if (source && replay.getAttribute("src") !== source) replay.src = source;
    status.update();
    form.enable();
  }

  function addEvents() {
    if (store.events[0] !== first || timeline.count > store.events.length) {
      timeline = new Timeline();
      notes.replaceChildren();
      first = store.events[0];
    }
    for (const event of store.events.slice(timeline.count)) {
      const note = timeline.add(event);
      const time = el("span", { class: "faint number" }, `${event.time_s.toFixed(1)} s  `);
      if (note) notes.append(el("li", {}, time, note));
    }
    while (notes.children.length > MAX_NOTES) notes.firstChild?.remove();
    notes.scrollTop = notes.scrollHeight;
    notesPanel.hidden = !notes.children.length;
  }

  /** @type {View["update"]} */
  function update(changed) {
    const isNew = changed.has("hello");
    map.update(changed);
    if (isNew && store.hello) form.load();
    if (isNew || changed.has("run")) showRun();
    if (isNew || changed.has("events")) {
      addEvents();
      timeline.draw(canvas, frame);
    }
  }

  const timer = setInterval(() => {
    if (store.run.phase !== "running" && store.run.phase !== "paused") return;
    showRun();
    timeline.draw(canvas, frame);
  }, 150);
  const observer = new ResizeObserver(() => timeline.draw(canvas, frame));
  observer.observe(frame);
  addEvents();
  return {
    update,
    leave() {
      clearInterval(timer);
      map.leave();
      plans.leave();
      observer.disconnect();
    },
  };
}

/**
 * Return a text of a file as an element of its own, so that one from right to left does not reorder what stands beside it.
 *
 * @param {string | null | undefined} text
 */
function isolated(text) {
  return el("bdi", {}, text ?? "");
}

class ScenarioForm {
  /** @type {ScenarioEntry[]} */
  scenarios = [];
  /** @type {Map<string, Field<Value | Value[] | undefined>>} */
  fields = new Map();

  constructor() {
    this.select = el("select", { "aria-label": "Scenario", onchange: () => this.choose(this.select.value) });
    this.about = el("p", { class: "small faint" });
    this.parameters = el("div", { class: "stack" });
    this.problems = el("ul", { class: "problems small" });
    this.start = el("button", { type: "submit", class: "primary" }, "Start");
    this.buttons = new Map(
      CONTROLS.map(([what, label]) => [
        what,
        el("button", { type: "button", onclick: () => this.control(what) }, label),
      ]),
    );
    this.node = el(
      "form",
      { class: "panel stack", noValidate: true, onsubmit: (/** @type {Event} */ event) => this.submit(event) },
      el("label", { class: "field" }, el("span", {}, "Scenario"), this.select),
      this.about,
      this.parameters,
      el("div", { class: "row" }, this.start, ...this.buttons.values()),
      this.problems,
    );
  }

  async load() {
    const answer = await request("scenarios", {});
    if (!answer.ok) {
      this.showProblems([answer.error ?? ""]);
      return;
    }
    this.scenarios = answer.scenarios;
    const options = this.scenarios.map(({ file, name, problems }) =>
      el("option", { value: file }, `${name}${problems.length ? " ✕" : ""}`),
    );
    this.select.replaceChildren(...options);
    const run = store.run.phase === "none" ? null : store.run.scenario; // of a page that was loaded during it or after
    const last = this.scenarios.find((entry) => (lastFile ? entry.file === lastFile : entry.name === run));
    const chosen = last ?? this.scenarios.find((entry) => !entry.problems.length);
    this.select.value = chosen?.file ?? "";
    this.choose(this.select.value);
  }

  /** @param {string} file */
  choose(file) {
    lastFile = file;
    const entry = this.scenarios.find((candidate) => candidate.file === file);
    if (entry) this.about.replaceChildren(isolated(entry.description), " (", isolated(entry.file), ")");
    else setText(this.about, "This folder holds no scenarios.");
    this.fields.clear();
    const labels = Object.entries(entry?.parameters ?? {}).map(([name, section]) => this.addField(name, section));
    this.parameters.replaceChildren(...labels);
    this.showProblems(entry?.problems ?? []);
    this.enable();
  }

  /** @param {string} name @param {Parameter} section */
  addField(name, section) {
    const field = parameterField(section);
    this.fields.set(name, field);
    const title = el("span", {}, name, section.unit ? ` [${section.unit}]` : "");
    const about = el("span", { class: "faint" }, isolated(section.description), " ", describeRange(section));
    return el("label", { class: "field" }, title, field.node, about);
  }

  /** @param {string[]} texts */
  showProblems(texts) {
    this.problems.replaceChildren(...texts.map((text) => el("li", {}, text)));
  }

  /** @param {Event} event */
  async submit(event) {
    event.preventDefault();
    /** @type {Record<string, Value | Value[]>} */
    const parameters = {};
    for (const [name, field] of this.fields) {
      const input = field.read();
      if (input.problem !== null) {
        this.showProblems([`${name} ${input.problem}`]);
        return;
      }
      if (input.value !== undefined) parameters[name] = input.value;
    }
    this.start.disabled = true;
    this.showProblems([]);
    const answer = await request("start", { file: this.select.value, parameters });
    if (!answer.ok) this.showProblems(answer.problems?.length ? answer.problems : [answer.error ?? ""]);
    this.enable();
  }

  /** @param {string} what */
  async control(what) {
    const answer = await request("control", { what });
    if (!answer.ok) this.showProblems([answer.error ?? ""]);
  }

  enable() {
    const { phase } = store.run;
    const isRunning = phase === "running" || phase === "paused";
    const may = store.may("run");
    this.start.disabled = !may || isRunning || !this.select.value;
    for (const [what, button] of this.buttons) {
      const isPossible = what === "abort" ? isRunning : phase === (what === "pause" ? "running" : "paused");
      button.disabled = !may || !isPossible;
    }
  }
}

/** The phase of the run, its progress, and the link to its report. */
class RunStatus {
  constructor() {
    this.phase = el("strong");
    this.detail = el("span", { class: "faint" });
    this.report = el("a", { target: "_blank", rel: "noopener", hidden: true }, "Report");
    this.progress = el("progress", { max: 1, value: 0, "aria-label": "Calls done" });
    const row = el("div", { class: "row" }, this.phase, this.detail, this.report);
    this.node = el("div", { class: "panel stack" }, row, this.progress);
  }

  update() {
    const run = store.run;
    this.progress.hidden = run.phase === "none";
    if (run.phase === "none") {
      setText(this.phase, "No run yet");
      setText(this.detail, "");
      this.report.hidden = true;
      return;
    }
    const [text, tone] = phaseOf(run);
    setText(this.phase, text);
    this.phase.className = `state ${tone}`;
    const duration_s = run.duration_s ?? store.fleetNow() - run.started_s;
    const calls = `${run.done} of ${Math.max(run.calls, run.done)} calls`;
    const duration = `${formatSeconds(Math.max(0, duration_s))} of fleet time`;
    const parts = [run.scenario, calls, duration, run.error];
    setText(this.detail, parts.filter(Boolean).join(" · "));
    this.report.hidden = !run.report;
    if (run.report) this.report.href = run.report;
    this.progress.max = Math.max(run.calls, run.done, 1);
    this.progress.value = run.done;
  }
}

/** @param {StartedRun} run @returns {[string, string]} */
function phaseOf(run) {
  if (run.phase === "running") return ["▶ Running", ""];
  if (run.phase === "paused") return ["❚❚ Paused", ""];
  return OUTCOMES[run.outcome ?? ""] ?? ["Ended", "warn"];
}
