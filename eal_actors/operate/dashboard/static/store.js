// What is known of the fleet, and who wants to be told when it changes.

import { seconds } from "./dom.js";

const MOST_LOGS = 1000, MOST_EVENTS = 20000, MOST_TRAIL = 300, TRAIL_STEP_M = 0.02;

export const store = {
  hello: null,
  robots: {},
  poses: {},
  trails: {},
  run: { phase: "none" },
  logs: [],
  logsLost: 0,
  events: [],
  eventsLost: 0,
  updates: [],
  onChange: () => {},
  nowAt: 0,
  now_s: 0,

  greet(hello) {
    Object.assign(this, { hello, robots: {}, poses: {}, trails: {}, run: { phase: "none" }, logs: [], events: [], logsLost: 0, eventsLost: 0 });
    for (const [name, points] of Object.entries(hello.trails)) this.trails[name] = points;
    this.onChange(new Set(["hello", "robots", "poses", "run", "logs", "events"]));
  },

  take(news) {
    this.now_s = news.now_s;
    this.nowAt = performance.now();
    this.updates.push(this.nowAt);
    while (this.updates[0] < this.nowAt - 2000) this.updates.shift();
    const changed = new Set();
    for (const kind of ["robots", "poses"]) {
      if (!news[kind]) continue;
      Object.assign(this[kind], news[kind]);
      changed.add(kind);
    }
    if (news.poses) for (const [name, pose] of Object.entries(news.poses)) this.trace(name, pose.at);
    if (news.run) {
      this.run = news.run[""];
      changed.add("run");
    }
    if (news.logs) changed.add("logs");
    for (const line of news.logs || []) this.logs.push(line);
    this.logs.splice(0, Math.max(0, this.logs.length - MOST_LOGS));
    this.logsLost += news.logs_lost || 0;
    for (const event of news.events || []) {
      changed.add("events");
      if (event.event === "run_started") {
        this.events = [];
        this.eventsLost = 0;
      }
      this.events.push(event);
    }
    this.events.splice(0, Math.max(0, this.events.length - MOST_EVENTS));
    this.eventsLost += news.events_lost || 0;
    this.onChange(changed);
  },

  trace(name, [x, y]) {
    const trail = (this.trails[name] ??= []);
    const last = trail[trail.length - 1];
    if (last && Math.hypot(last[0] - x, last[1] - y) < TRAIL_STEP_M) return;
    trail.push([x, y]);
    if (trail.length > MOST_TRAIL) trail.shift();
  },

  // Seconds of the fleet's clock, now.
  fleetNow() {
    return this.now_s + ((performance.now() - this.nowAt) / 1000) * (this.hello?.rate ?? 1);
  },

  updatesPerSecond() {
    const since = performance.now() - 2000;
    return this.updates.filter((time) => time >= since).length / 2;
  },

  names() {
    return this.hello?.robots ?? [];
  },

  stopped() {
    return this.names().filter((name) => this.robots[name]?.stopped);
  },

  mayCommand() {
    return Boolean(this.hello?.may_command);
  },
};

// Most calls are commands, so that need not be said.
export function shortLabel(label) {
  return label.replace(/^send_cmd /, "");
}

// What a robot does: its commands with their progress, else the step of the run that it is at; empty if nothing.
export function doingsOf(robot) {
  const commands = (robot?.running ?? []).map((running) => ({
    text: running.command, fraction: running.progress?.fraction ?? null, note: running.progress?.text ?? "", by: running.by, since_s: running.since_s,
  }));
  if (commands.length || !robot?.step) return commands;
  return [{ text: shortLabel(robot.step.label), fraction: null, note: "", by: null, since_s: robot.step.since_s }];
}

export function doingText(doing) {
  const parts = [doing.fraction === null ? doing.note : `${Math.round(doing.fraction * 100)} %${doing.note ? ` ${doing.note}` : ""}`,
    seconds(Math.max(0, store.fleetNow() - doing.since_s)), doing.by ? `by ${doing.by}` : ""];
  return [doing.text, ...parts.filter(Boolean)].join(", ");
}

// Who commands a robot's resources, in words; empty if nobody does.
export function controlText(robot) {
  return Object.entries(robot?.control ?? {}).map(([resource, who]) => {
    const name = who === store.hello?.you ? "this page" : /^browser \d+$/.test(who) ? `another page (${who})` : who;
    return resource ? `${resource}: ${name}` : name;
  }).join(", ");
}

const STATES = {
  ready: ["●", "ready", "good"],
  starting: ["◌", "starting", "warn"],
  lost: ["▲", "lost", "bad"],
  failed: ["✕", "failed", "bad"],
  stopped: ["○", "disconnected", "warn"],
};

// A robot's state as a shape, a word and a colour.
export function stateOf(robot) {
  if (!robot) return ["◌", "unknown", "warn"];
  if (robot.state === "ready" && robot.stopped) return ["■", "stopped", "bad"];
  if (robot.state === "ready" && Object.keys(robot.not_ready).length) return ["◐", "not all ready", "warn"];
  return STATES[robot.state] ?? ["?", robot.state, "warn"];
}
