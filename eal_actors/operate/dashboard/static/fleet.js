// All robots, one row each.

import { el, setText } from "./dom.js";
import { controlText, doingsOf, doingText, stateOf, store } from "./store.js";

const COLUMNS = ["Robot", "State", "Battery", "Link", "Doing", "Control", "Last error"];

export function fleetView(root) {
  const tiles = el("div", { class: "tiles", "aria-label": "Summary" });
  const body = el("tbody");
  const table = el("table", { class: "table" },
    el("caption", { class: "skip" }, "Robots of the fleet"),
    el("thead", {}, el("tr", {}, ...COLUMNS.map((title) => el("th", { scope: "col" }, title)))), body);
  root.append(el("h1", {}, "Fleet"), tiles, table);
  const rows = new Map();
  const timer = setInterval(() => update(new Set(["time"])), 500);

  function update(changed) {
    if (changed.has("hello")) {
      rows.clear();
      body.replaceChildren();
      for (const name of store.names()) {
        const row = new Row(name);
        rows.set(name, row);
        body.append(row.node);
      }
    }
    if (changed.has("hello") || changed.has("robots") || changed.has("time")) {
      for (const row of rows.values()) row.update();
      summarize(tiles);
    }
  }
  return { update, leave: () => clearInterval(timer) };
}

function summarize(tiles) {
  const counts = new Map();
  for (const name of store.names()) {
    const [shape, word, tone] = stateOf(store.robots[name]);
    const entry = counts.get(word) ?? { shape, tone, count: 0 };
    entry.count += 1;
    counts.set(word, entry);
  }
  const text = JSON.stringify([...counts]);
  if (tiles.dataset.shown === text) return;
  tiles.dataset.shown = text;
  tiles.replaceChildren(
    el("span", { class: "tile" }, el("b", {}, String(store.names().length)), "robots"),
    ...[...counts].map(([word, { shape, tone, count }]) =>
      el("span", { class: `tile state ${tone}` }, el("b", {}, String(count)), `${shape} ${word}`)));
}

class Row {
  constructor(name) {
    this.name = name;
    this.shown = "";
    this.cells = COLUMNS.map((title) => el("td", { "data-label": title }));
    this.node = el("tr", {}, ...this.cells);
    this.node.dataset.robot = name;
    for (const index of [0, 4, 5, 6]) this.cells[index].classList.add("wide");
  }

  update() {
    const robot = store.robots[this.name];
    const doings = doingsOf(robot), told = doings.map(doingText), control_ = controlText(robot);
    const calls = ["running", "paused"].includes(store.run.phase) ? store.run.done_by?.[this.name] : undefined;
    const text = JSON.stringify([robot, told, control_, calls]);
    if (text === this.shown) return;
    this.shown = text;
    const [shape, word, tone] = stateOf(robot);
    const [who, state, battery, way, doing, control, error] = this.cells;
    who.replaceChildren(el("a", { href: `#/robot/${encodeURIComponent(this.name)}` }, this.name), " ",
      el("span", { class: "faint small" }, robot?.type ?? ""));
    state.replaceChildren(el("span", { class: `state ${tone}` }, el("span", { "aria-hidden": "true" }, shape), word));
    for (const [resource, reason] of Object.entries(robot?.not_ready ?? {})) state.append(el("div", { class: "small" }, `${resource}: ${reason}`));
    for (const problem of robot?.problems ?? []) state.append(el("div", { class: "small" }, problem));
    battery.replaceChildren(...batteryParts(robot?.battery));
    setText(way, !robot ? "" : !robot.is_remote ? "this process" : robot.round_trip_ms === null ? "▲ no answer" : `${robot.round_trip_ms.toFixed(1)} ms`);
    way.className = "number";
    doing.replaceChildren(...(doings.length ? doings.map((one, index) => el("div", {}, progressOf(one.fraction), `▶ ${told[index]}`))
      : [el("span", { class: "faint" }, robot?.can_drive ? "idle" : "")]),
      calls === undefined ? "" : el("div", { class: "small faint" }, `${store.run.scenario}: ${calls} calls done`));
    control.replaceChildren(control_ || el("span", { class: "faint" }, "nobody"));
    setText(error, robot?.last_error ?? "");
    error.classList.toggle("empty", !robot?.last_error);
  }
}

function progressOf(fraction) {
  if (fraction === null) return null;
  const bar = el("span");
  bar.style.width = `${Math.round(fraction * 100)}%`;
  return el("span", { class: "meter", "aria-hidden": "true" }, bar);
}

function batteryParts(level) {
  if (level === null || level === undefined) return [el("span", { class: "faint" }, "–")];
  const bar = el("span");
  bar.style.width = `${Math.round(level * 100)}%`;
  return [el("span", { class: `meter${level < 0.2 ? " low" : ""}`, "aria-hidden": "true" }, bar), `${Math.round(level * 100)} %${level < 0.2 ? " low" : ""}`];
}
