// The page's state, as the server last reported it.

import { formatSeconds } from "./dom.js";
import { forgetPoses, notePoses } from "./history.js";

/** @import { Activity, Change, Hello, LiveValue, LogLine, Point, Pose, Robot, Role, Run, RunEvent, StartedRun, Tone, TrailPoint, Update } from "./types" */

/** @type {Role[]} */
const ROLES = ["watch", "drive", "run", "administer"];
const MAX_LOGS = 1000;
const MAX_EVENTS = 20000;
const MAX_TRAIL_POINTS = 300;
const TRAIL_STEP_M = 0.02;
const RATE_WINDOW_MS = 2000;
/** Charge of a battery below which it is low, 0 to 1. */
export const LOW_BATTERY = 0.2;
const DEFAULT_BOUNDS = [-2, -1.5, 2, 1.5];

class Store {
  /** @type {Hello | null} */
  hello = null;
  /** @type {Record<string, Robot>} */
  robots = {};
  /** @type {Record<string, Pose>} */
  poses = {};
  /** @type {Record<string, Record<string, LiveValue>>} Of the robot whose page is open. */
  values = {};
  /** @type {Record<string, TrailPoint[]>} */
  trails = {};
  /** @type {Record<string, Point[] | null>} Planned paths of the robots that are under way. */
  paths = {};
  /** @type {Run} */
  run = { phase: "none" };
  /** @type {LogLine[]} */
  logs = [];
  logsLost = 0;
  /** @type {RunEvent[]} */
  events = [];
  /** @type {(changed: Set<Change>) => void} */
  onChange = () => {};
  /** @type {number[]} When the last updates came. */
  #updates = [];
  #updatedAt = 0;
  /** The time of the newest update, by the fleet's clock. */
  heard_s = 0;

  /**
   * Start anew with the first message of a connection.
   *
   * @param {Hello} hello
   */
  reset(hello) {
    this.hello = hello;
    this.heard_s = hello.now_s;
    this.#updatedAt = performance.now();
    this.robots = {};
    this.poses = {};
    this.values = {};
    this.trails = Object.fromEntries(
      Object.entries(hello.trails).map(([name, points]) => [name, points.map(([x, y]) => [x, y, -Infinity])]),
    );
    forgetPoses();
    this.paths = {};
    this.run = { phase: "none" };
    this.logs = [];
    this.logsLost = 0;
    this.events = [];
    this.onChange(new Set(["hello", "robots", "poses", "run", "logs", "events"]));
  }

  /**
   * Return whether an update is of the robots that the page knows. A removed robot is null.
   *
   * @param {Update} update
   */
  hasSameRobots(update) {
    return Object.entries(update.robots ?? {}).every(([name, robot]) => this.names().includes(name) === Boolean(robot));
  }

  /** @param {Update} update */
  apply(update) {
    this.#countUpdate(update.now_s);
    /** @type {Set<Change>} */
    const changed = new Set();
    if (update.robots) {
      for (const [name, robot] of Object.entries(update.robots)) if (robot) this.robots[name] = robot;
      changed.add("robots");
    }
    if (update.poses) {
      Object.assign(this.poses, update.poses);
      for (const [name, pose] of Object.entries(update.poses)) this.#extendTrail(name, pose);
      notePoses(this.poses);
      changed.add("poses");
    }
    if (update.values) {
      this.values = update.values;
      changed.add("values");
    }
    if (update.paths) {
      Object.assign(this.paths, update.paths);
      changed.add("poses");
    }
    if (update.run) {
      this.run = update.run[""];
      changed.add("run");
    }
    if (update.logs) {
      this.logs.push(...update.logs);
      this.logs.splice(0, this.logs.length - MAX_LOGS);
      changed.add("logs");
    }
    this.logsLost += update.logs_lost ?? 0;
    if (update.events) {
      this.#addEvents(update.events);
      changed.add("events");
    }
    this.onChange(changed);
  }

  /** @param {number} now_s */
  #countUpdate(now_s) {
    this.heard_s = now_s;
    this.#updatedAt = performance.now();
    this.#updates = this.#updates.filter((time) => time >= this.#updatedAt - RATE_WINDOW_MS);
    this.#updates.push(this.#updatedAt);
  }

  /** @param {RunEvent[]} events */
  #addEvents(events) {
    const start = events.findLastIndex((event) => event.event === "run_started");
    if (start >= 0) this.events = [];
    this.events.push(...events.slice(Math.max(start, 0)));
    this.events.splice(0, this.events.length - MAX_EVENTS);
  }

  /** @param {string} name @param {Pose} pose */
  #extendTrail(name, { at: [x, y] }) {
    this.trails[name] ??= [];
    const trail = this.trails[name];
    const last = trail.at(-1);
    if (last && Math.hypot(last[0] - x, last[1] - y) < TRAIL_STEP_M) return;
    trail.push([x, y, performance.now()]);
    if (trail.length > MAX_TRAIL_POINTS) trail.shift();
  }

  /** Return the time of the fleet's clock, in seconds. */
  fleetNow() {
    return this.heard_s + ((performance.now() - this.#updatedAt) / 1000) * (this.hello?.rate ?? 1);
  }

  /** Return whether the fleet's clock goes as fast as real time. */
  isRealTime() {
    return (this.hello?.rate ?? 1) === 1;
  }

  updatesPerSecond() {
    const since = performance.now() - RATE_WINDOW_MS;
    return this.#updates.filter((time) => time >= since).length / (RATE_WINDOW_MS / 1000);
  }

  names() {
    return this.hello?.robots ?? [];
  }

  stopped() {
    return this.names().filter((name) => this.robots[name]?.stopped);
  }

  /** Return the stopped robots that have not confirmed it: they may still move. */
  unconfirmed() {
    return this.stopped().filter((name) => !this.robots[name].is_stop_confirmed);
  }

  /** @param {Role} role */
  may(role) {
    return ROLES.indexOf(this.hello?.role ?? "watch") >= ROLES.indexOf(role);
  }

  mayCommand() {
    return Boolean(this.hello?.may_command);
  }
}

export const store = new Store();

/**
 * Return whether a run goes on.
 *
 * @param {Run} run
 * @returns {run is StartedRun}
 */
export function isActive(run) {
  return run.phase === "running" || run.phase === "paused";
}

/**
 * Shorten a step's label: most steps are commands, so the method is left out.
 *
 * @param {string} label
 */
export function shortLabel(label) {
  return label.replace(/^send_cmd /, "");
}

/**
 * Return a robot's current commands, else its current step of the run; empty if it is idle.
 *
 * @param {Robot | undefined} robot
 * @returns {Activity[]}
 */
export function activitiesOf(robot) {
  const commands = (robot?.running ?? []).map((running) => ({
    text: running.command,
    fraction: running.progress?.fraction ?? null,
    note: running.progress?.text ?? "",
    by: running.by,
    since_s: running.since_s,
  }));
  if (commands.length || !robot?.step) return commands;
  return [{ text: shortLabel(robot.step.label), fraction: null, note: "", by: null, since_s: robot.step.since_s }];
}

/** @param {Activity} activity */
export function activityText({ text, fraction, note, by, since_s }) {
  const percent = fraction === null ? "" : `${Math.round(fraction * 100)} %`;
  const progress = [percent, note].filter(Boolean).join(" ");
  const duration = `${formatSeconds(Math.max(0, store.fleetNow() - since_s))}${store.isRealTime() ? "" : " of fleet time"}`;
  return [text, progress, duration, by && `by ${by}`].filter(Boolean).join(", ");
}

/**
 * Name the controllers of a robot's resources; empty if there are none.
 *
 * @param {Robot | undefined} robot
 */
export function controlText(robot) {
  return Object.entries(robot?.control ?? {})
    .map(([resource, controller]) => (resource ? `${resource}: ${pageName(controller)}` : pageName(controller)))
    .join(", ");
}

/** @param {string} controller */
function pageName(controller) {
  if (controller === store.hello?.you) return "this page";
  return /^browser \d+$/.test(controller) ? `another page (${controller})` : controller;
}

/** @type {Record<string, [string, string, Tone]>} */
const STATES = {
  ready: ["●", "ready", "good"],
  starting: ["◌", "starting", "warn"],
  lost: ["▲", "lost", "bad"],
  failed: ["✕", "failed", "bad"],
  stopped: ["○", "disconnected", "warn"],
};

/**
 * Return a robot's state as a shape, a word and a tone.
 *
 * @param {Robot | undefined} robot
 * @returns {[string, string, Tone]}
 */
export function stateOf(robot) {
  if (!robot) return ["◌", "unknown", "warn"];
  if (robot.stopped && !robot.is_stop_confirmed) return ["▲", "stop NOT CONFIRMED", "bad"];
  if (robot.state === "ready" && robot.stopped) return ["■", "stopped", "bad"];
  const waiting = Object.keys(robot.not_ready).length;
  if (robot.state === "ready" && waiting)
    return ["◐", waiting < robot.resources.length ? "partly ready" : "not ready", "warn"];
  return STATES[robot.state] ?? ["?", robot.state, "warn"];
}

/** Return what is known of a robot without a command: a lost one may be moving. @param {Robot | undefined} robot */
export function restText(robot) {
  return robot?.state === "ready" ? "idle" : "unknown";
}

/** Return why resources are not ready; those with the same reason together. @param {Robot} robot */
export function reasonsNotReady({ not_ready }) {
  /** @type {Map<string, string[]>} */
  const resources = new Map();
  for (const [resource, reason] of Object.entries(not_ready)) {
    const plain = reason.replace(/; next try in .*$/, "");
    resources.set(plain, [...(resources.get(plain) ?? []), resource]);
  }
  return [...resources].map(([reason, names]) => `${names.join(", ")}: ${reason}`);
}

/**
 * Return whether a robot has all words of a search in its name, type, tags or state.
 *
 * @param {string} name
 * @param {Robot | undefined} robot
 * @param {string} search
 */
export function matches(name, robot, search) {
  const text = [name, robot?.type, ...(robot?.tags ?? []), stateOf(robot)[1]].join(" ").toLowerCase();
  return search
    .toLowerCase()
    .split(/\s+/)
    .every((word) => text.includes(word));
}

/** Return the extent of the world, else of the poses and trails, in metres: left, low, right, high. */
export function worldBounds() {
  const world = store.hello?.world;
  if (world) {
    const [width_m, height_m] = world.size_m;
    return [-width_m / 2, -height_m / 2, width_m / 2, height_m / 2];
  }
  const points = [...Object.values(store.poses).map((pose) => pose.at), ...Object.values(store.trails).flat()];
  if (!points.length) return DEFAULT_BOUNDS;
  let [left, low, right, high] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of points) {
    left = Math.min(left, x);
    right = Math.max(right, x);
    low = Math.min(low, y);
    high = Math.max(high, y);
  }
  return [left - 1, low - 1, right + 1, high + 1];
}
