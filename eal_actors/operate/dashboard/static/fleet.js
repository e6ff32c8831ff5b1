// All robots, one row each: search, sort, group by tag, and commands to a selection.

import { request } from "./connection.js";
import { clockTime, el, meterOf, setText, throttled } from "./dom.js";
import { stateIcon } from "./icons.js";
import { SelectionBar } from "./selection.js";
import {
  activitiesOf,
  activityText,
  controlText,
  isActive,
  LOW_BATTERY,
  matches,
  reasonsNotReady,
  restText,
  stateOf,
  store,
} from "./store.js";

/** @import { Robot, Tone, View } from "./types" */
/** @typedef {(robot: Robot | undefined, name: string) => string | number} SortKey */

const READABLE_MS = 250; // texts that change more often are not read, and cost frames
const TONES = ["bad", "warn", "good"];
/** @type {[string, SortKey | null][]} Columns, and what they sort by. */
const COLUMNS = [
  ["Robot", null],
  ["State", (robot) => TONES.indexOf(stateOf(robot)[2])],
  ["Battery", (robot) => robot?.battery ?? 2],
  ["Round trip", (robot) => -(robot?.round_trip_ms ?? -1)],
  ["Activity", (robot) => (activitiesOf(robot).length ? 0 : 1)],
  ["Controlled by", (robot) => controlText(robot) || "\uffff"],
  ["Last error", (robot) => (robot?.last_error ? 0 : 1)],
];
const WIDE = [0, 4, 5, 6];

/** @param {HTMLElement} root @returns {View} */
export function fleetView(root) {
  const summary = el("div", { class: "tiles", "aria-label": "Summary" });
  const reloaded = el("span", { class: "small", role: "status" });
  const reload = el("button", { type: "button", id: "reload" }, "Reload the fleet file");
  reload.onclick = async () => {
    const answer = await request("reload", {});
    setText(reloaded, answer.ok ? answer.changes : ((answer.problems?.join(" · ") || answer.error) ?? ""));
  };
  const table = new FleetTable();
  root.append(
    el("div", { class: "row" }, el("h1", {}, "Fleet"), summary, el("span", { class: "grow" }), reloaded, reload),
    el("div", { class: "row" }, table.search, table.groupLabel),
    table.bar.node,
    table.node,
  );
  const show = throttled(() => {
    table.update();
    summarize(summary);
    reload.disabled = !store.may("administer");
  }, READABLE_MS);
  const timer = setInterval(show, 500);

  /** @type {View["update"]} */
  function update(changed) {
    if (changed.has("hello")) table.reset();
    if (changed.has("hello") || changed.has("robots")) show();
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
      el("span", { class: `tile state ${tone}` }, stateIcon(shape), el("b", {}, String(count)), word),
    ),
  );
}

class FleetTable {
  /** @type {Row[]} */
  rows = [];
  /** @type {{ column: number, isReversed: boolean }} */
  sorting = { column: 0, isReversed: false };
  #order = "";
  search = el("input", {
    type: "search",
    placeholder: "Find by name, type, tag or state",
    "aria-label": "Find robots",
  });
  group = el(
    "select",
    {},
    el("option", { value: "" }, "nothing"),
    el("option", { value: "tag" }, "tag"),
    el("option", { value: "type" }, "type"),
  );
  groupLabel = el("label", {}, "Group by", this.group);
  all = el("input", { type: "checkbox", "aria-label": "Select all shown robots" });
  bar = new SelectionBar(() => this.clear());

  constructor() {
    this.heads = COLUMNS.map(([title], column) => {
      const button = el("button", { type: "button", class: "sort" }, title);
      button.onclick = () => this.sortBy(column);
      return el("th", { scope: "col" }, button);
    });
    this.node = el(
      "table",
      { class: "table" },
      el("caption", { class: "skip" }, "Robots of the fleet"),
      el("thead", {}, el("tr", {}, el("th", { class: "pick" }, this.all), ...this.heads)),
    );
    this.search.oninput = this.group.onchange = () => this.update();
    this.all.onchange = () => {
      for (const row of this.rows) if (row.node.isConnected) row.box.checked = this.all.checked;
      this.showSelection();
    };
  }

  /** Make the rows of the robots that there are now; those that stay selected stay so. */
  reset() {
    const kept = new Map(this.rows.map((row) => [row.name, row]));
    this.rows = store.names().map((name) => kept.get(name) ?? new Row(name, () => this.showSelection()));
    this.#order = "";
    this.showSelection();
  }

  /** @param {number} column */
  sortBy(column) {
    this.sorting = { column, isReversed: this.sorting.column === column && !this.sorting.isReversed };
    this.heads.forEach((head, index) => {
      if (index === column) head.setAttribute("aria-sort", this.sorting.isReversed ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    });
    this.update();
  }

  update() {
    for (const row of this.rows) row.update();
    const groups = this.#groups();
    const order = JSON.stringify(groups.map(([title, rows]) => [title, rows.map((row) => row.name)]));
    if (order === this.#order) return;
    this.#order = order;
    for (const body of [...this.node.tBodies]) body.remove();
    for (const [title, rows] of groups) {
      const head = el("th", { colSpan: COLUMNS.length + 1, scope: "rowgroup" }, `${title} (${rows.length})`);
      this.node.append(
        el("tbody", {}, title ? el("tr", { class: "group" }, head) : null, ...rows.map((row) => row.node)),
      );
    }
    if (!groups.length) {
      const none = store.names().length ? "No robot matches." : "The fleet has no robots.";
      this.node.append(el("tbody", {}, el("tr", {}, el("td", { colSpan: COLUMNS.length + 1, class: "faint" }, none))));
    }
    this.showSelection();
  }

  /** @returns {[string, Row[]][]} */
  #groups() {
    const shown = this.rows.filter((row) => matches(row.name, store.robots[row.name], this.search.value));
    const { column, isReversed } = this.sorting;
    const key = COLUMNS[column][1];
    if (key)
      shown.sort((one, other) =>
        compare(key(store.robots[one.name], one.name), key(store.robots[other.name], other.name)),
      );
    if (isReversed) shown.reverse();
    if (!shown.length) return [];
    if (!this.group.value) return [["", shown]];
    /** @type {Map<string, Row[]>} */
    const groups = new Map();
    for (const row of shown) {
      const robot = store.robots[row.name];
      const title = (this.group.value === "tag" ? robot?.tags.join(", ") || "no tag" : robot?.type) ?? "unknown";
      groups.set(title, [...(groups.get(title) ?? []), row]);
    }
    return [...groups].sort(([one], [other]) => compare(one, other));
  }

  showSelection() {
    const chosen = this.rows.filter((row) => row.box.checked && row.node.isConnected).map((row) => row.name);
    for (const row of this.rows) row.node.classList.toggle("chosen", chosen.includes(row.name));
    const shown = this.rows.filter((row) => row.node.isConnected).length;
    this.all.checked = chosen.length > 0 && chosen.length === shown;
    this.all.indeterminate = chosen.length > 0 && chosen.length < shown;
    this.bar.show(chosen);
  }

  clear() {
    for (const row of this.rows) row.box.checked = false;
    this.showSelection();
  }
}

/** @param {string | number} one @param {string | number} other */
function compare(one, other) {
  return one < other ? -1 : Number(one > other);
}

class Row {
  /** @param {string} name @param {() => void} onChoose */
  constructor(name, onChoose) {
    this.name = name;
    this.shown = "";
    this.box = el("input", { type: "checkbox", "aria-label": `Select ${name}`, onchange: onChoose });
    this.cells = COLUMNS.map(([title]) => el("td", { "data-label": title }));
    this.node = el("tr", { "data-robot": name }, el("td", { class: "pick" }, this.box), ...this.cells);
    for (const index of WIDE) this.cells[index].classList.add("wide");
  }

  update() {
    const robot = store.robots[this.name];
    const activities = activitiesOf(robot).map((activity) => ({ ...activity, line: activityText(activity) }));
    const controllers = controlText(robot);
    const { run } = store;
    const calls =
      isActive(run) && this.name in run.done_by ? `${run.scenario}: ${run.done_by[this.name]} calls done` : "";
    const content = JSON.stringify([robot, activities, controllers, calls]);
    if (content === this.shown) return;
    this.shown = content;
    this.node.classList.toggle("outdated", Boolean(robot?.last_seen));
    const [name, state, battery, roundTrip, activity, control, error] = this.cells;
    const tags = (robot?.tags ?? []).map((tag) => el("span", { class: "tag" }, tag));
    const type = el("span", { class: "faint small" }, robot?.type);
    name.replaceChildren(el("a", { href: `#/robot/${encodeURIComponent(this.name)}` }, this.name), " ", type, ...tags);
    state.replaceChildren(...stateParts(robot));
    battery.replaceChildren(...batteryParts(robot?.battery ?? null));
    setText(roundTrip, roundTripText(robot));
    roundTrip.className = "number";
    const lines = activities.map(({ fraction, line }) => el("div", {}, meterOf(fraction), `▶ ${line}`));
    if (!lines.length) lines.push(el("div", { class: "faint" }, robot?.can_drive && restText(robot)));
    activity.replaceChildren(...lines, el("div", { class: "small faint" }, calls));
    control.replaceChildren(
      controllers || el("span", { class: "faint" }, robot?.state === "ready" ? "nobody" : "unknown"),
    );
    setText(error, robot?.last_error ?? "");
    error.classList.toggle("empty", !robot?.last_error);
  }
}

/** @param {Robot | undefined} robot */
function stateParts(robot) {
  const [shape, word, tone] = stateOf(robot);
  const reasons = robot ? reasonsNotReady(robot) : [];
  if (robot?.last_seen) reasons.unshift(`last seen ${clockTime(new Date(robot.last_seen))}`);
  return [
    el("span", { class: `state ${tone}` }, stateIcon(shape), word),
    ...[...reasons, ...(robot?.problems ?? [])].map((text) => el("div", { class: "small" }, text)),
  ];
}

/** @param {Robot | undefined} robot */
function roundTripText(robot) {
  if (!robot) return "";
  if (!robot.is_remote) return "this process";
  return robot.round_trip_ms === null ? "▲ no answer" : `${robot.round_trip_ms.toFixed(1)} ms`;
}

/** @param {number | null} charge */
function batteryParts(charge) {
  if (charge === null) return [el("span", { class: "faint" }, "–")];
  const low = charge < LOW_BATTERY ? "low" : "";
  return [meterOf(charge, low) ?? "", `${Math.round(charge * 100)} % ${low}`.trim()];
}
