// One robot: its state, its camera beside the drive pad, its live values, its commands and its configuration.

import { Tile } from "./cameras.js";
import { commandsPanel, readingsPanel, settingsPanel } from "./commands.js";
import { request } from "./connection.js";
import { clockTime, el, fixed, setText } from "./dom.js";
import { DrivePanel } from "./drive.js";
import { watch as watchCameras } from "./frames.js";
import { stateIcon } from "./icons.js";
import { activitiesOf, activityText, controlText, reasonsNotReady, restText, stateOf, store } from "./store.js";
import { ValuesPanel } from "./values.js";

/** @import { Pose, Robot, View } from "./types" */

const CAMERA_RATE_HZ = 5;
const AGE_MS = 200;

/** @param {HTMLElement} root @param {string} name @returns {View} */
export function robotView(root, name) {
  const state = el("span", { class: "state" });
  const facts = el("dl", { class: "facts" });
  const problems = el("ul", { class: "problems marked small" });
  const cockpit = el("div", { class: "cockpit" });
  const values = new ValuesPanel(name);
  const camera = new CameraPanel(name);
  const can = el("div", { class: "stack" }, el("p", { class: "faint" }, "Loading the robot's resources …"));
  root.append(
    el(
      "div",
      { class: "row" },
      el("h1", {}, name),
      state,
      el("span", { class: "grow" }),
      el("a", { href: "#/fleet" }, "All robots"),
    ),
    facts,
    problems,
    el("div", { class: "robot" }, cockpit, values.node, can),
  );
  /** @type {DrivePanel | null} */
  let panel = null;
  let described = "";

  async function describe() {
    const answer = await request("describe", { robot: name });
    if (!answer.ok) {
      described = ""; // the next update tries again
      can.replaceChildren(el("p", { class: "faint" }, answer.error));
      return;
    }
    const { resources } = answer;
    values.describe(resources);
    can.replaceChildren(commandsPanel(name, resources), readingsPanel(name, resources), settingsPanel(name, resources));
  }

  /** @type {View["update"]} */
  function update(changed) {
    const robot = store.robots[name];
    if (changed.has("hello")) {
      values.watch();
      camera.watch();
    }
    if (changed.has("hello") || changed.has("values")) values.update();
    if (store.hello && !store.names().includes(name)) setText(can, `The fleet has no robot ${name}.`);
    if (!robot) return;
    const [shape, word, tone] = stateOf(robot);
    if (state.textContent !== word) state.replaceChildren(stateIcon(shape), word);
    state.className = `state ${tone}`;
    showFacts(facts, factsOf(robot, store.poses[name]));
    showProblems(problems, problemsOf(robot));
    camera.update(robot.cameras);
    if (camera.node.parentNode === null && robot.cameras.length) cockpit.prepend(camera.node);
    if (robot.can_drive && !panel) {
      panel = new DrivePanel(name);
      cockpit.append(panel.node);
    }
    const current = [robot.state, ...robot.resources, ...Object.keys(robot.not_ready)].join();
    if (described !== current) {
      described = current;
      describe();
    }
  }
  return {
    update,
    leave() {
      panel?.leave();
      camera.leave();
      values.leave();
    },
  };
}

/** The picture of one of the robot's cameras; the first one until the user chooses. */
class CameraPanel {
  /** @type {Tile | null} */
  #tile = null;
  #names = "";
  #timer = setInterval(() => this.#tile?.showAge(), AGE_MS);

  /** @param {string} robot */
  constructor(robot) {
    this.robot = robot;
    this.choice = el("select", { "aria-label": "Camera", onchange: () => this.#show(this.choice.value) });
    this.place = el("div");
    this.node = el("section", { class: "eye stack", "aria-label": "Camera" }, this.choice, this.place);
  }

  /** @param {string[]} cameras */
  update(cameras) {
    if (this.#names === cameras.join()) return;
    this.#names = cameras.join();
    this.choice.replaceChildren(...cameras.map((camera) => el("option", { value: camera }, camera)));
    this.choice.hidden = cameras.length < 2;
    if (cameras.length) this.#show(cameras[0]);
  }

  /** @param {string} camera */
  #show(camera) {
    this.#tile = new Tile(`${this.robot}/${camera}`, () => CAMERA_RATE_HZ);
    this.place.replaceChildren(this.#tile.node);
    this.watch();
  }

  /** Ask the server for the frames; after each new connection. */
  watch() {
    const tile = this.#tile;
    if (tile) watchCameras(this, [tile.camera], CAMERA_RATE_HZ, (header, jpeg) => tile.show(header, jpeg));
  }

  leave() {
    clearInterval(this.#timer);
    watchCameras(this, [], CAMERA_RATE_HZ, () => {});
  }
}

/** @param {Robot} robot @param {Pose | undefined} pose @returns {[string, string][]} */
function factsOf(robot, pose) {
  const activities = activitiesOf(robot).map(activityText);
  return [
    ["Type", [robot.type, ...robot.tags].filter(Boolean).join(" · ")],
    ["Activity", activities.length ? `▶ ${activities.join("; ")}` : restText(robot)],
    ["Controlled by", controlText(robot) || (robot.state === "ready" ? "nobody" : "unknown")],
    ["Position", pose ? poseText(pose, robot.pose_seen ?? robot.last_seen) : "unknown"],
    ["Battery", robot.battery === null ? "" : `${Math.round(robot.battery * 100)} %`],
    ["Link", linkText(robot)],
  ];
}

/** @param {Robot} robot */
function linkText({ is_remote, round_trip_ms, last_seen }) {
  if (!is_remote) return "in this process";
  if (round_trip_ms !== null) return `${round_trip_ms} ms`;
  return last_seen ? `▲ last seen ${clockTime(new Date(last_seen))}` : "▲ no answer";
}

/** @param {Pose} pose @param {string | null} seen - when it was measured, if that was long ago. */
function poseText({ at: [x, y, yaw], by }, seen) {
  const old = seen ? `, ▲ of ${clockTime(new Date(seen))}` : "";
  return `${fixed(x, 2)}, ${fixed(y, 2)} m, ${fixed((yaw * 180) / Math.PI, 0)}° by ${by}${old}`;
}

/** @param {Robot} robot */
function problemsOf(robot) {
  return [
    robot.stopped && `■ stopped: ${robot.stopped}`,
    ...reasonsNotReady(robot).map((reason) => `▲ not ready: ${reason}`),
    ...robot.problems.map((problem) => `▲ ${problem}`),
    robot.last_error && `✕ last error: ${robot.last_error}`,
  ].filter((text) => typeof text === "string");
}

/** @param {HTMLElement} list @param {[string, string][]} facts */
function showFacts(list, facts) {
  const shown = facts.filter(([, text]) => text);
  if (list.children.length !== shown.length) {
    list.replaceChildren(...shown.map(([title]) => el("div", {}, el("dt", {}, title), el("dd", {}))));
  }
  shown.forEach(([title, text], index) => {
    const [term, value] = list.children[index].children;
    setText(term, title);
    setText(value, text);
  });
}

/** @param {HTMLElement} list @param {string[]} texts */
function showProblems(list, texts) {
  list.hidden = !texts.length;
  if (list.dataset.shown === texts.join("\n")) return;
  list.dataset.shown = texts.join("\n");
  list.replaceChildren(...texts.map((text) => el("li", {}, text)));
}
