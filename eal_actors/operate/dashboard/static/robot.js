// One robot: its state, driving by hand, and a form for each command, request and configuration key of its resources.

import { request } from "./connection.js";
import { el, fixed, setText } from "./dom.js";
import { DrivePanel } from "./drive.js";
import { describeValue, valueField } from "./fields.js";
import { activitiesOf, activityText, controlText, stateOf, store } from "./store.js";

/** @import { AnswerTo, Argument, CommandDescription, Pose, ResourceDescription, Robot, ValueDescription, View } from "./types" */
/** @typedef {(value: Argument) => Promise<AnswerTo<"call">>} Action */
/** @typedef {(method: string, text?: string) => Action} Call */

/** @param {HTMLElement} root @param {string} name @returns {View} */
export function robotView(root, name) {
  const state = el("span", { class: "state" });
  const facts = el("p", { class: "small faint" });
  const resources = el("div", { class: "stack" }, el("p", { class: "faint" }, "Loading the robot's resources …"));
  const side = el("div", { class: "stack" });
  const back = el("a", { href: "#/fleet" }, "All robots");
  root.append(
    el("div", { class: "row" }, el("h1", {}, name), state, el("span", { class: "grow" }), back),
    facts,
    el("div", { class: "robot" }, resources, side),
  );
  /** @type {DrivePanel | null} */
  let panel = null;
  let described = "";

  async function showResources() {
    const answer = await request("describe", { robot: name });
    if (answer.ok) {
      resources.replaceChildren(...answer.resources.map((info, index) => renderResource(name, info, index === 0)));
    } else {
      described = ""; // the next update tries again
      resources.replaceChildren(el("p", { class: "faint" }, answer.error));
    }
  }

  function update() {
    const robot = store.robots[name];
    if (!robot) return;
    const [shape, word, tone] = stateOf(robot);
    state.className = `state ${tone}`;
    setText(state, `${shape} ${word}`);
    setText(facts, factsOf(robot, store.poses[name]).filter(Boolean).join(" · "));
    if (robot.can_drive && !panel) {
      panel = new DrivePanel(name);
      side.prepend(panel.node);
    }
    if (described !== robot.resources.join()) {
      described = robot.resources.join();
      showResources();
    }
  }
  return { update, leave: () => panel?.leave() };
}

/** @param {Robot} robot @param {Pose | undefined} pose */
function factsOf(robot, pose) {
  const activities = activitiesOf(robot).map(activityText);
  const control = controlText(robot);
  return [
    robot.type,
    robot.battery === null ? null : `battery ${Math.round(robot.battery * 100)} %`,
    robot.is_remote ? `round trip ${robot.round_trip_ms ?? "–"} ms` : "in this process",
    pose ? poseText(pose) : null,
    activities.length ? `▶ ${activities.join("; ")}` : "idle",
    control ? `controlled by ${control}` : null,
    robot.stopped ? `stopped: ${robot.stopped}` : null,
    ...Object.entries(robot.not_ready).map(([resource, reason]) => `${resource}: ${reason}`),
    robot.last_error ? `last error: ${robot.last_error}` : null,
  ];
}

/** @param {Pose} pose */
function poseText({ at: [x, y, yaw], by }) {
  return `at ${fixed(x, 2)}, ${fixed(y, 2)} m, ${fixed((yaw * 180) / Math.PI, 0)}° (${by})`;
}

/** @param {string} robot @param {ResourceDescription} info @param {boolean} isOpen */
function renderResource(robot, info, isOpen) {
  /** @type {Call} */
  const call = (method, text) => (value) => request("call", { robot, resource: info.name, method, text, value });
  const about = `${info.types.join(", ").toLowerCase()}${info.description ? ` – ${info.description}` : ""}`;
  return el(
    "details",
    { class: "panel", open: isOpen },
    el("summary", {}, info.name, " ", el("span", { class: "faint small" }, about)),
    el("div", { class: "stack" }, ...formsOf(info, call)),
  );
}

/** @param {ResourceDescription} info @param {Call} call */
function formsOf(info, call) {
  const forms = [];
  const about = describeValue(info.value);
  if (info.methods.includes("get_value")) {
    forms.push(form({ title: "value", verb: "Read", action: call("get_value"), about }));
  }
  if (info.methods.includes("set_value") && info.value) {
    forms.push(form({ title: "set value", verb: "Set", action: call("set_value"), about, argument: info.value }));
  }
  for (const command of info.commands) forms.push(commandForm(command, "Send", "send_cmd", call));
  for (const command of info.requests) forms.push(commandForm(command, "Request", "send_req", call));
  for (const { name, value, writable, description } of info.configs) {
    const text = [description, describeValue(value)].filter(Boolean).join(" ");
    forms.push(form({ title: name, verb: "Get", action: call("get_config", name), about: text }));
    if (writable) {
      forms.push(form({ title: `set ${name}`, verb: "Set", action: call("set_config", name), argument: value }));
    }
  }
  if (info.methods.includes("get_status")) {
    forms.push(form({ title: "status", verb: "Read", action: call("get_status") }));
  }
  return forms;
}

/**
 * Return the form of a command or request. Its argument is part of the text (`r<degrees>`) or separate.
 *
 * @param {CommandDescription} command
 * @param {string} verb
 * @param {string} method
 * @param {Call} call
 */
function commandForm({ name, argument, returns, description }, verb, method, call) {
  const prefix = /^(.*)<\w+>$/.exec(name)?.[1];
  /** @type {Action} */
  const action = (value) =>
    prefix === undefined ? call(method, name)(value) : call(method, `${prefix}${value}`)(null);
  const about = [
    description,
    argument ? `Argument: ${describeValue(argument)}.` : "",
    returns ? `Returns: ${describeValue(returns)}.` : "",
  ];
  return form({ title: name, verb, action, about: about.filter(Boolean).join(" "), argument });
}

/** @param {{ title: string, verb: string, action: Action, about?: string, argument?: ValueDescription | null }} options */
function form({ title, verb, action, about, argument }) {
  const output = el("output", { class: "small" });
  const field = argument ? valueField(argument, title) : null;

  /** @param {string} text @param {string} tone */
  function show(text, tone) {
    output.className = `small ${tone}`;
    setText(output, text);
  }

  /** @param {Event} event */
  async function submit(event) {
    event.preventDefault();
    const input = field?.read() ?? { problem: null, value: null };
    if (input.problem !== null) {
      show(input.problem, "bad");
      return;
    }
    show("…", "");
    const answer = await action(input.value);
    if (answer.ok) show(answer.value ? `✓ ${answer.value}` : "✓ done", "good");
    else show(`✕ ${answer.error}`, "bad");
  }

  const unit = argument?.unit ? el("span", { class: "faint" }, argument.unit) : null;
  return el(
    "form",
    { class: "form", noValidate: true, onsubmit: submit },
    el("div", { class: "what" }, el("code", {}, title), about ? el("span", { class: "about" }, about) : null),
    el("div", { class: "inputs" }, field?.node, unit),
    el("button", { type: "submit", "aria-label": `${verb}: ${title}` }, verb),
    output,
  );
}
