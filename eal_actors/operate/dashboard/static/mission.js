// Mission control: the map, the robots, their cameras and what needs a person, on one page.

import { showAlerts } from "./alerts.js";
import { Tile } from "./cameras.js";
import { el, linkToRobot, meterOf, setText, throttled } from "./dom.js";
import { mostCameras, watch } from "./frames.js";
import { stateIcon } from "./icons.js";
import { FleetMap } from "./map.js";
import { robotColour } from "./map_robots.js";
import { activitiesOf, activityText, isActive, LOW_BATTERY, matches, restText, stateOf, store } from "./store.js";

/** @import { Robot, View } from "./types" */

const STRIP_HZ = 4;
const STRIP_CAMERAS = 3; // one is left for the picture of the floor
const READABLE_MS = 250; // texts that change more often are not read, and cost frames of the map
const MANY = 8; // robots from which the list has a search field

/** @param {HTMLElement} root @returns {View} */
export function missionView(root) {
  root.className = "mission";
  const map = new FleetMap();
  const strip = new Strip();
  const list = new RobotList(map);
  const alerts = el("ul", { class: "alerts" });
  const count = el("span", { class: "count" });
  const run = el("div", { class: "run-now" });
  root.append(
    el("h1", { class: "unseen" }, "Mission control"),
    el("section", { class: "mission-map", "aria-label": "Map" }, map.node),
    el(
      "div",
      { class: "mission-side" },
      run,
      el("section", { class: "panel mission-alerts", "aria-label": "Alerts" }, el("h2", {}, "Alerts ", count), alerts),
      el("section", { class: "panel robots", "aria-label": "Robots" }, ...list.nodes),
    ),
    strip.node,
  );
  map.observe();
  const showTexts = throttled(() => {
    list.update();
    showRun(run);
    showAlerts(alerts, count);
  }, READABLE_MS);
  const timer = setInterval(() => {
    showTexts();
    strip.showAges();
  }, 500);

  /** @type {View["update"]} */
  function update(changed) {
    map.update(changed);
    if (changed.has("hello") || changed.has("robots")) strip.update(changed.has("hello"));
    if (changed.has("hello") || changed.has("robots") || changed.has("logs") || changed.has("run")) showTexts();
  }
  return {
    update,
    leave() {
      clearInterval(timer);
      map.leave();
      strip.leave();
    },
  };
}

// The run.

/** @param {HTMLElement} node */
function showRun(node) {
  const { run } = store;
  node.hidden = !isActive(run);
  const shown = JSON.stringify(run);
  if (!isActive(run) || node.dataset.shown === shown) return;
  node.dataset.shown = shown;
  node.replaceChildren(
    el("strong", {}, `${run.phase === "paused" ? "❚❚ Paused" : "▶ Running"}: ${run.scenario}`),
    el("progress", { max: Math.max(run.calls, 1), value: run.done, "aria-label": "Calls done" }),
    el("span", { class: "small" }, `${run.done} of ${run.calls} calls`, " "),
    el("a", { class: "small", href: "#/scenario" }, "Details"),
  );
}

// The robots.

class RobotList {
  /** @type {Map<string, { node: HTMLElement, shown: string }>} */
  items = new Map();
  list = el("ul", { class: "robot-list" });
  search = el("input", {
    type: "search",
    placeholder: "Find robots by name, type, tag or state",
    "aria-label": "Find robots",
  });
  title = el("h2", {}, "Robots");
  nodes = [
    el("div", { class: "row" }, this.title, el("span", { class: "grow" }), el("a", { href: "#/fleet" }, "Table")),
    this.search,
    this.list,
  ];

  /** @param {FleetMap} map */
  constructor(map) {
    this.map = map;
    this.search.oninput = () => this.update();
  }

  update() {
    const names = store.names();
    this.search.hidden = names.length < MANY;
    const ready = names.filter((name) => stateOf(store.robots[name])[2] === "good").length;
    setText(this.title, `Robots: ${ready} of ${names.length} ready`);
    for (const name of this.items.keys()) {
      if (names.includes(name)) continue;
      this.items.get(name)?.node.remove();
      this.items.delete(name);
    }
    for (const [index, name] of names.entries()) this.show(name, index);
  }

  /** @param {string} name @param {number} index */
  show(name, index) {
    let item = this.items.get(name);
    if (!item) {
      const node = el("li", { "data-robot": name });
      node.onpointerenter = () => this.mark(name);
      node.onpointerleave = () => this.mark(null);
      item = { node, shown: "" };
      this.items.set(name, item);
      this.list.append(node);
    }
    const robot = store.robots[name];
    item.node.hidden = !this.search.hidden && !matches(name, robot, this.search.value);
    const activities = activitiesOf(robot).map(activityText);
    const shown = JSON.stringify([index, robot?.type, stateOf(robot), robot?.battery, activities, robot?.last_seen]);
    if (item.node.hidden || shown === item.shown) return;
    item.shown = shown;
    const [shape, word, tone] = stateOf(robot);
    const dot = el("span", { class: "dot", "aria-hidden": "true" });
    dot.style.background = robotColour(index);
    item.node.replaceChildren(
      dot,
      el("span", { class: "what" }, linkToRobot(name), " ", el("span", { class: "faint small" }, robot?.type)),
      el("span", { class: `state ${tone} small` }, stateIcon(shape), word),
      el(
        "span",
        { class: "small faint doing" },
        activities.length ? `▶ ${activities.join("; ")}` : robot?.can_drive && restText(robot),
      ),
      el("span", { class: "small charge" }, ...chargeOf(robot)),
    );
  }

  /** @param {string | null} name */
  mark(name) {
    this.map.marked = name;
    this.map.redraw();
  }
}

/** @param {Robot | undefined} robot */
function chargeOf(robot) {
  const charge = robot?.battery ?? null;
  if (charge === null) return [];
  return [meterOf(charge, charge < LOW_BATTERY ? "low" : ""), `${Math.round(charge * 100)} %`];
}

// The cameras.

class Strip {
  /** @type {Map<string, Tile>} */
  tiles = new Map();
  offset = 0;
  grid = el("div", { class: "strip" });
  more = el("button", { type: "button" }, "Next cameras");
  node = el(
    "section",
    { class: "mission-cameras", "aria-label": "Cameras", hidden: true },
    el(
      "div",
      { class: "row" },
      el("h2", { class: "grow" }, "Cameras"),
      this.more,
      el("a", { href: "#/cameras" }, "Choose"),
    ),
    this.grid,
  );
  #shown = "";

  constructor() {
    this.more.onclick = () => {
      this.offset += STRIP_CAMERAS;
      this.update(false);
    };
  }

  /** @param {boolean} isNew - whether the connection is new. */
  update(isNew) {
    const all = store.names().flatMap((name) => {
      const [camera] = (store.robots[name]?.cameras ?? []).filter((resource) => resource !== "Floor");
      return camera ? [`${name}/${camera}`] : [];
    });
    const most = Math.min(STRIP_CAMERAS, mostCameras());
    if (this.offset >= all.length) this.offset = 0;
    const keys = all.slice(this.offset, this.offset + most);
    this.node.hidden = !all.length;
    this.more.hidden = all.length <= most;
    if (keys.join() === this.#shown && !isNew) return;
    this.#shown = keys.join();
    this.tiles = new Map(keys.map((key) => [key, this.tiles.get(key) ?? new Tile(key, () => STRIP_HZ)]));
    this.grid.replaceChildren(...[...this.tiles.values()].map((tile) => tile.node));
    const cameras = [...this.tiles.values()].map((tile) => tile.camera);
    watch(this, cameras, STRIP_HZ, (header, jpeg) =>
      this.tiles.get(`${header.robot}/${header.resource}`)?.show(header, jpeg),
    );
  }

  showAges() {
    for (const tile of this.tiles.values()) tile.showAge();
  }

  leave() {
    watch(this, [], 1, () => {});
  }
}
