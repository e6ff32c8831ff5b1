// One robot: how it is, driving by hand, and a form for each thing that its resources say they can do.

import { el, fixed, setText } from "./dom.js";
import { ask } from "./link.js";
import { controlText, doingsOf, doingText, stateOf, store } from "./store.js";
import { Drive } from "./drive.js";

const NUMBERS = ["INT", "FLOAT", "DOUBLE"];

export function robotView(root, name) {
  const state = el("span", { class: "state" });
  const facts = el("p", { class: "small faint" });
  const resources = el("div", { class: "stack" }, el("p", { class: "faint" }, "Asking the robot what it offers …"));
  const side = el("div", { class: "stack" });
  root.append(el("div", { class: "row" }, el("h1", {}, name), state, el("span", { class: "grow" }), el("a", { href: "#/fleet" }, "All robots")), facts,
    el("div", { class: "robot" }, resources, side));
  let drive = null, asked = "";

  async function describe() {
    const answer = await ask({ do: "describe", robot: name });
    if (!answer.ok) {
      asked = "";
      resources.replaceChildren(el("p", { class: "faint" }, answer.error));
      return;
    }
    resources.replaceChildren(...answer.resources.map((info, index) => resourceOf(name, info, index === 0)));
  }

  function update() {
    const robot = store.robots[name];
    if (!robot) return;
    const [shape, word, tone] = stateOf(robot);
    state.className = `state ${tone}`;
    setText(state, `${shape} ${word}`);
    const doings = doingsOf(robot), control = controlText(robot);
    const pose = store.poses[name];
    setText(facts, [
      robot.type, robot.battery === null ? null : `battery ${Math.round(robot.battery * 100)} %`,
      robot.is_remote ? `round trip ${robot.round_trip_ms ?? "–"} ms` : "in this process",
      pose ? `at ${fixed(pose.at[0], 2)}, ${fixed(pose.at[1], 2)} m, ${fixed((pose.at[2] * 180) / Math.PI, 0)}° by ${pose.by}` : null,
      doings.length ? `▶ ${doings.map(doingText).join("; ")}` : "idle", control ? `commanded by ${control}` : null,
      robot.stopped ? `stopped: ${robot.stopped}` : null, ...Object.entries(robot.not_ready).map(([key, why]) => `${key}: ${why}`),
      robot.last_error ? `last error: ${robot.last_error}` : null,
    ].filter(Boolean).join(" · "));
    if (robot.can_drive && !drive) {
      drive = new Drive(name);
      side.prepend(drive.node);
    }
    if (asked !== robot.resources.join()) {
      asked = robot.resources.join();
      describe();
    }
  }
  return { update, leave: () => drive?.leave() };
}

function resourceOf(robot, info, isOpen) {
  const forms = [];
  const send = (method, text) => (value) => ask({ do: "call", robot, resource: info.name, method, text, value });
  if (info.methods.includes("get_value")) forms.push(form("value", info.value, null, "Read", send("get_value"), describe(info.value)));
  if (info.methods.includes("set_value") && info.value) forms.push(form("set value", info.value, info.value, "Set", send("set_value"), describe(info.value)));
  for (const command of info.commands) forms.push(command_(command, "Do", "send_cmd", send));
  for (const request of info.requests) forms.push(command_(request, "Ask", "send_req", send));
  for (const config of info.configs) {
    forms.push(form(config.name, config.value, null, "Get", send("get_config", config.name), [config.description, describe(config.value)].filter(Boolean).join(" ")));
    if (config.writable) forms.push(form(`set ${config.name}`, config.value, config.value, "Set", send("set_config", config.name), ""));
  }
  if (info.methods.includes("get_status")) forms.push(form("status", null, null, "Read", send("get_status"), ""));
  return el("details", { class: "panel", open: isOpen }, el("summary", {}, info.name, " ",
    el("span", { class: "faint small" }, `${info.types.join(", ").toLowerCase()}${info.description ? ` – ${info.description}` : ""}`)), el("div", { class: "stack" }, ...forms));
}

// A command or request, whose argument stands in its text (`r<degrees>`) or beside it.
function command_(command, verb, method, send) {
  const inText = /^(.*)<\w+>$/.exec(command.name);
  const action = (value) => (inText ? send(method, `${inText[1]}${value}`)(null) : send(method, command.name)(value));
  return form(command.name, command.argument, command.argument, verb, action,
    [command.description, command.argument ? `Takes ${describe(command.argument)}.` : "", command.returns ? `Answers ${describe(command.returns)}.` : ""].filter(Boolean).join(" "));
}

function form(title, value, argument, verb, action, about) {
  const output = el("output", { class: "small" });
  const input = argument ? inputOf(argument, title) : null;
  const button = el("button", { type: "submit" }, verb);
  button.setAttribute("aria-label", `${verb}: ${title}`);
  const node = el("form", { class: "form", onsubmit: async (event) => {
    event.preventDefault();
    const [problem, given] = input ? input.read() : [null, null];
    if (problem) return show(problem, "bad");
    show("…", "");
    const answer = await action(given);
    show(answer.ok ? (answer.value === undefined ? "done" : `✓ ${answer.value}`) : `✕ ${answer.error}`, answer.ok ? "good" : "bad");
  } }, el("div", { class: "what" }, el("code", {}, title), about ? el("span", { class: "about" }, about) : null), el("div", { class: "inputs" }, input?.node ?? null, argument?.unit ? el("span", { class: "faint" }, argument.unit) : null), button, output);
  node.noValidate = true;
  function show(text, tone) {
    output.className = `small ${tone}`;
    setText(output, text);
  }
  return node;
}

// What to type a value into, and how to read it: [what is wrong, the value].
function inputOf(info, title) {
  if (info.shape.length) {
    const node = el("input", { type: "text", placeholder: info.shape.length === 1 ? "numbers, separated by commas" : "not here", "aria-label": title });
    return { node, read() {
      const numbers = node.value.split(/[\s,]+/).filter(Boolean).map(Number);
      if (numbers.length === 0 || numbers.some(Number.isNaN)) return ["must be numbers, separated by commas", null];
      if (info.shape.length !== 1 || (info.shape[0] !== null && info.shape[0] !== numbers.length)) return [`must be ${describe(info)}`, null];
      return [null, numbers];
    } };
  }
  if (info.type === "BOOL") {
    const node = el("select", { "aria-label": title }, el("option", { value: "true" }, "true"), el("option", { value: "false" }, "false"));
    return { node, read: () => [null, node.value === "true"] };
  }
  if (info.choices.length) {
    const node = el("select", { "aria-label": title }, ...info.choices.map((choice, index) => el("option", { value: index }, String(choice))));
    return { node, read: () => [null, info.choices[Number(node.value)]] };
  }
  if (!NUMBERS.includes(info.type)) {
    const node = el("input", { type: "text", "aria-label": title });
    return { node, read: () => [null, node.value] };
  }
  const node = el("input", { type: "number", "aria-label": title, step: info.type === "INT" ? "1" : "any" });
  if (info.minimum !== null) node.min = info.minimum;
  if (info.maximum !== null) node.max = info.maximum;
  node.placeholder = `${info.minimum ?? ""} … ${info.maximum ?? ""}`;
  return { node, read() {
    const number = node.valueAsNumber;
    const isWrong = Number.isNaN(number) || (info.type === "INT" && !Number.isInteger(number)) ||
      (info.minimum !== null && number < info.minimum) || (info.maximum !== null && number > info.maximum);
    return isWrong ? [`must be ${describe(info)}`, null] : [null, number];
  } };
}

// `double 0..360 deg`, as the command line writes it.
function describe(info) {
  if (!info) return "";
  const parts = [info.type.toLowerCase()];
  if (info.shape.length) parts.push(`(${info.shape.map((size) => size ?? "n").join(", ")})`);
  if (info.minimum !== null || info.maximum !== null) parts.push(`${info.minimum ?? ""}..${info.maximum ?? ""}`);
  if (info.choices.length) parts.push(info.choices.join("|"));
  if (info.unit) parts.push(info.unit);
  return parts.join(" ") + (info.description ? ` (${info.description})` : "");
}
