// All robots, one row each.

import { request } from "./connection.js";
import { clockTime, el, setText } from "./dom.js";
import { activitiesOf, activityText, controlText, stateOf, store } from "./store.js";

/** @import { Robot, Tone, View } from "./types" */

const COLUMNS = ["Robot", "State", "Battery", "Round trip", "Activity", "Controlled by", "Last error"];
const LOW_BATTERY = 0.2;

/** @param {HTMLElement} root @returns {View} */
export function fleetView(root) {
  const summary = el("div", { class: "tiles", "aria-label": "Summary" });
  const body = el("tbody");
  const titles = COLUMNS.map((title) => el("th", { scope: "col" }, title));
  const reloaded = el("span", { class: "small", role: "status" });
  const reload = el("button", { type: "button", id: "reload" }, "Reload the fleet file");
  reload.onclick = async () => {
    const answer = await request("reload", {});
    setText(reloaded, answer.ok ? answer.changes : ((answer.problems?.join(" · ") || answer.error) ?? ""));
  };
  root.append(
    el("h1", {}, "Fleet"),
    summary,
    el("p", {}, reload, " ", reloaded),
    el(
      "table",
      { class: "table" },
      el("caption", { class: "skip" }, "Robots of the fleet"),
      el("thead", {}, el("tr", {}, ...titles)),
      body,
    ),
  );
  /** @type {Row[]} */
  let rows = [];
  const timer = setInterval(() => update(new Set(["time"])), 500);

  /** @type {View["update"]} */
  function update(changed) {
    if (changed.has("hello")) {
      rows = store.names().map((name) => new Row(name));
      body.replaceChildren(...rows.map((row) => row.node));
    }
    if (changed.has("hello") || changed.has("robots") || changed.has("time")) {
      for (const row of rows) row.update();
      summarize(summary);
      reload.disabled = !store.may("administer");
    }
  }
  return { update, leave: () => clearInterval(timer) };
}

/** @param {HTMLElement} summary */
function summarize(summary) {
  /** @type {Map<string, { shape: string, tone: Tone, count: number }>} */
  const counts = new Map();
  for (const name of store.names()) {
    const [shape, word, tone] = stateOf(store.robots[name]);
    const entry = counts.get(word) ?? { shape, tone, count: 0 };
    entry.count += 1;
    counts.set(word, entry);
  }
  const text = JSON.stringify([...counts]);
  if (summary.dataset.shown === text) return;
  summary.dataset.shown = text;
  summary.replaceChildren(
    el("span", { class: "tile" }, el("b", {}, String(store.names().length)), "robots"),
    ...[...counts].map(([word, { shape, tone, count }]) =>
      el("span", { class: `tile state ${tone}` }, el("b", {}, String(count)), `${shape} ${word}`),
    ),
  );
}

class Row {
  /** @param {string} name */
  constructor(name) {
    this.name = name;
    this.shown = "";
    this.cells = COLUMNS.map((title) => el("td", { "data-label": title }));
    this.node = el("tr", { "data-robot": name }, ...this.cells);
    for (const index of [0, 4, 5, 6]) this.cells[index].classList.add("wide");
  }

  update() {
    const robot = store.robots[this.name];
    const activities = activitiesOf(robot).map((activity) => ({ ...activity, line: activityText(activity) }));
    const controllers = controlText(robot);
    const run = store.run;
    const isRunning = run.phase === "running" || run.phase === "paused";
    const calls = isRunning && this.name in run.done_by ? `${run.scenario}: ${run.done_by[this.name]} calls done` : "";
    const content = JSON.stringify([robot, activities, controllers, calls]);
    if (content === this.shown) return;
    this.shown = content;
    this.node.classList.toggle("outdated", Boolean(robot?.last_seen));
    const [name, state, battery, roundTrip, activity, control, error] = this.cells;
    const type = el("span", { class: "faint small" }, robot?.type);
    name.replaceChildren(el("a", { href: `#/robot/${encodeURIComponent(this.name)}` }, this.name), " ", type);
    state.replaceChildren(...stateParts(robot));
    battery.replaceChildren(...batteryParts(robot?.battery ?? null));
    setText(roundTrip, roundTripText(robot));
    roundTrip.className = "number";
    const lines = activities.map(({ fraction, line }) => el("div", {}, meterOf(fraction), `▶ ${line}`));
    if (!lines.length) lines.push(el("div", { class: "faint" }, robot?.can_drive && "idle"));
    activity.replaceChildren(...lines, el("div", { class: "small faint" }, calls));
    control.replaceChildren(controllers || el("span", { class: "faint" }, "nobody"));
    setText(error, robot?.last_error ?? "");
    error.classList.toggle("empty", !robot?.last_error);
  }
}

/** @param {Robot | undefined} robot */
function stateParts(robot) {
  const [shape, word, tone] = stateOf(robot);
  const reasons = Object.entries(robot?.not_ready ?? {}).map(([resource, reason]) => `${resource}: ${reason}`);
  if (robot?.last_seen) reasons.unshift(`last seen ${clockTime(new Date(robot.last_seen))}`);
  return [
    el("span", { class: `state ${tone}` }, el("span", { "aria-hidden": "true" }, shape), word),
    ...[...reasons, ...(robot?.problems ?? [])].map((text) => el("div", { class: "small" }, text)),
  ];
}

/** @param {Robot | undefined} robot */
function roundTripText(robot) {
  if (!robot) return "";
  if (!robot.is_remote) return "this process";
  return robot.round_trip_ms === null ? "▲ no answer" : `${robot.round_trip_ms.toFixed(1)} ms`;
}

/** @param {number | null} fraction @param {string} [kind] */
function meterOf(fraction, kind = "") {
  if (fraction === null) return null;
  const bar = el("span");
  bar.style.width = `${Math.round(fraction * 100)}%`;
  return el("span", { class: `meter ${kind}`, "aria-hidden": "true" }, bar);
}

/** @param {number | null} charge */
function batteryParts(charge) {
  if (charge === null) return [el("span", { class: "faint" }, "–")];
  const low = charge < LOW_BATTERY ? "low" : "";
  return [meterOf(charge, low) ?? "", `${Math.round(charge * 100)} % ${low}`.trim()];
}
