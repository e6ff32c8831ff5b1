// Alerts: what needs a person, the gravest first. The same alert of several robots is one.

import { clockTime, el, linkToRobot, setText } from "./dom.js";
import { stateIcon } from "./icons.js";
import { LOW_BATTERY, reasonsNotReady, stateOf, store } from "./store.js";

/** @import { Robot, Tone } from "./types" */
/** @typedef {{ tone: Tone, shape: string, text: string }} Finding */
/** @typedef {Finding & { robots: string[], at: string }} Alert */

const RECENT_MS = 10 * 60_000;
const NAMED = 3; // robots that an alert names
const GRAVITY = { bad: 0, warn: 1, good: 2 };

/** The alerts of one moment. */
class Alerts {
  /** @type {Map<string, Alert>} */
  #found = new Map();

  /** @param {string | null} robot @param {Finding} finding @param {string} [at] - the time of a line of the log. */
  add(robot, finding, at = "") {
    const key = JSON.stringify([finding.tone, finding.shape, finding.text, at !== ""]);
    const alert = this.#found.get(key) ?? { ...finding, robots: [], at };
    if (robot && !alert.robots.includes(robot)) alert.robots.push(robot);
    if (at > alert.at) alert.at = at;
    this.#found.set(key, alert);
  }

  sorted() {
    return [...this.#found.values()].sort((one, other) => GRAVITY[one.tone] - GRAVITY[other.tone]);
  }
}

function currentAlerts() {
  const alerts = new Alerts();
  for (const name of store.names()) {
    const robot = store.robots[name];
    if (robot) addRobot(alerts, name, robot);
  }
  if (store.run.phase === "ended" && store.run.outcome && store.run.outcome !== "done") {
    const { outcome, error, scenario } = store.run;
    const text = [`${scenario}: ${outcome}`, error].filter(Boolean).join(": ");
    alerts.add(null, { tone: "bad", shape: "✕", text });
  }
  const now = Date.now();
  for (const { level, at, robot, text } of store.logs.toReversed()) {
    if ((level === "error" || level === "critical") && now - new Date(at).getTime() < RECENT_MS)
      alerts.add(robot, { tone: "bad", shape: "✕", text }, at);
  }
  return alerts.sorted();
}

/** @param {Alerts} alerts @param {string} name @param {Robot} robot */
function addRobot(alerts, name, robot) {
  const [shape, word, tone] = stateOf(robot);
  if (tone !== "good" && word !== "stopped") {
    alerts.add(name, { tone, shape, text: [word, ...reasonsNotReady(robot), ...robot.problems].join(" · ") });
  }
  if (tone === "good" && robot.pose_seen) {
    alerts.add(name, {
      tone: "warn",
      shape: "▲",
      text: `has reported no pose since ${clockTime(new Date(robot.pose_seen))}`,
    });
  }
  if (robot.battery !== null && robot.battery < LOW_BATTERY) {
    alerts.add(name, { tone: "warn", shape: "▽", text: `battery ${Math.round(robot.battery * 100)} %` });
  }
  if (robot.last_error && robot.state !== "failed") {
    const text = robot.last_error.replaceAll(`${name}/`, ""); // so that those of several robots are the same
    alerts.add(name, { tone: "warn", shape: "▲", text });
  }
}

/** @param {HTMLElement} list @param {HTMLElement} count */
export function showAlerts(list, count) {
  const alerts = currentAlerts();
  const shown = JSON.stringify(alerts);
  if (list.dataset.shown === shown) return;
  list.dataset.shown = shown;
  setText(count, alerts.length ? String(alerts.length) : "");
  count.className = alerts.some(({ tone }) => tone === "bad") ? "count bad" : "count";
  list.replaceChildren(
    ...alerts.map(({ robots, tone, shape, text, at }) => {
      const time = at && `${clockTime(new Date(at))} `;
      const what = el("span", { class: "what" }, ...namesOf(robots), `${time}${text}`);
      return el("li", { class: `state ${tone}` }, stateIcon(shape), what);
    }),
  );
  list.closest("section")?.classList.toggle("calm", !alerts.length);
  if (alerts.length) return;
  const calm = el("span", { class: "what faint" }, "Nothing needs attention.");
  list.append(el("li", { class: "state good" }, stateIcon("●"), calm));
}

/** Return links to the robots of an alert; to the table where there are many. @param {string[]} robots */
function namesOf(robots) {
  const links = robots.slice(0, NAMED).flatMap((name) => [linkToRobot(name), " "]);
  const others = robots.length - NAMED;
  if (others <= 0) return links;
  return [...links, el("a", { href: "#/fleet", title: robots.join(", ") }, `and ${others} more`), " "];
}
