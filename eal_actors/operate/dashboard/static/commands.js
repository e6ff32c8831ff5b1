// What a robot can do, as forms in words: its commands, the readings that are asked for, and its configuration.

import { request } from "./connection.js";
import { el, setText } from "./dom.js";
import { describeInput, describeValue, valueField } from "./fields.js";
import { store } from "./store.js";

/** @import { AnswerTo, Argument, CommandDescription, ConfigDescription, ResourceDescription, ValueDescription } from "./types" */
/** @typedef {(value: Argument) => Promise<AnswerTo<"call">>} Action */
/** @typedef {(method: string, text?: string) => Action} Call */
/** @typedef {{ words: string, more?: string, code: string, verb: string, action: Action }} FormTexts */
/** @typedef {FormTexts & { argument?: ValueDescription | null, isAllowed?: boolean }} FormOptions */
/** @typedef {{ node: HTMLElement, read?: () => Promise<void> }} FormRow - `read` shows the current value. */

/** @param {string} robot @param {ResourceDescription} info @returns {Call} */
function callOf(robot, info) {
  return (method, text) => (value) => request("call", { robot, resource: info.name, method, text, value });
}

/**
 * Return the commands of a robot, by resource: buttons for those without an argument, forms for the others.
 *
 * @param {string} robot
 * @param {ResourceDescription[]} resources
 */
export function commandsPanel(robot, resources) {
  const isActuator = (/** @type {ResourceDescription} */ info) => Number(info.types.includes("ACTUATOR"));
  const ordered = resources.toSorted((one, other) => isActuator(other) - isActuator(one));
  const groups = ordered.map((info) => commandsOf(info, callOf(robot, info))).filter((node) => node !== null);
  const none = el("p", { class: "faint" }, "This robot has no commands.");
  return el(
    "section",
    { class: "panel commands", "aria-label": "Commands" },
    el("h2", {}, "Commands"),
    ...(groups.length ? groups : [none]),
  );
}

/** @param {ResourceDescription} info @param {Call} call */
function commandsOf(info, call) {
  const plain = info.commands.filter((command) => !command.argument);
  const others = info.commands
    .filter((command) => command.argument)
    .sort((one, other) => dimensions(one) - dimensions(other));
  const rows = others.map((command) => commandRow(command, "Send", "send_cmd", call));
  if (info.methods.includes("set_value") && info.value) {
    const texts = { words: "Set the value", more: info.value.description, code: "set_value", verb: "Set" };
    rows.push(formRow({ ...texts, action: call("set_value"), argument: info.value }));
  }
  if (!plain.length && !rows.length) return null;
  const buttons = plain.map((command) => commandButton(command, call("send_cmd", command.name)));
  return el(
    "div",
    { class: "group", role: "group", "aria-label": info.name },
    el("h3", {}, info.name, " ", el("span", { class: "faint small" }, info.description)),
    buttons.length ? el("div", { class: "buttons" }, ...buttons) : null,
    ...rows.map((row) => row.node),
  );
}

/** @param {CommandDescription} command */
function dimensions({ argument }) {
  return argument?.shape.length ?? 0;
}

/**
 * Return the readings of a robot that must be asked for: requests, states, and values that are not live.
 *
 * @param {string} robot
 * @param {ResourceDescription[]} resources
 */
export function readingsPanel(robot, resources) {
  return folded("Readings", "asked for once", resources, (info) => {
    const call = callOf(robot, info);
    const rows = info.requests.map((command) => commandRow(command, "Read", "send_req", call));
    if (info.methods.includes("get_value")) {
      const texts = { words: "Value", more: describeValue(info.value), code: "get_value", verb: "Read" };
      rows.unshift(formRow({ ...texts, action: call("get_value") }));
    }
    if (info.methods.includes("get_status")) {
      rows.push(formRow({ words: "Status", code: "get_status", verb: "Read", action: call("get_status") }));
    }
    return rows;
  });
}

/** @param {string} robot @param {ResourceDescription[]} resources */
export function settingsPanel(robot, resources) {
  return folded("Configuration", "settings and their values", resources, (info) =>
    info.configs.map((config) => settingRow(config, callOf(robot, info))),
  );
}

/**
 * Return a folded panel with a folded part for each resource. A part's values are read when it is first opened, one
 * after another, because a page may send ten commands a second.
 *
 * @param {string} title
 * @param {string} about
 * @param {ResourceDescription[]} resources
 * @param {(info: ResourceDescription) => FormRow[]} rowsOf
 */
function folded(title, about, resources, rowsOf) {
  const parts = resources.flatMap((info) => {
    const rows = rowsOf(info);
    if (!rows.length) return [];
    const summary = el("summary", {}, info.name, " ", el("span", { class: "faint small" }, info.description));
    const part = el("details", { class: "fold" }, summary, ...rows.map((row) => row.node));
    part.addEventListener("toggle", () => readAll(rows), { once: true });
    return [part];
  });
  const count = el("span", { class: "faint small" }, `${about} · ${parts.length} resources`);
  const heading = el("summary", {}, el("h2", {}, title, " ", count));
  return el("details", { class: "panel folds", hidden: !parts.length }, heading, ...parts);
}

/** @param {FormRow[]} rows */
async function readAll(rows) {
  for (const row of rows) await row.read?.();
}

/** @param {ConfigDescription} config @param {Call} call @returns {FormRow} */
function settingRow({ name, value, writable, description }, call) {
  const current = el("output", { class: "now number" });
  async function read() {
    const answer = await call("get_config", name)(null);
    setText(current, answer.ok ? answer.value : `✕ ${answer.error}`);
  }
  const texts = { words: description ? splitClause(description)[0] : name, code: name };
  if (!writable) {
    const node = el(
      "div",
      { class: "form" },
      describe({ ...texts, about: `read only · ${describeInput(value)}` }),
      current,
    );
    return { node, read };
  }
  const { node } = formRow({
    ...texts,
    verb: "Set",
    argument: value,
    isAllowed: store.may("administer"),
    action: async (input) => {
      const answer = await call("set_config", name)(input);
      if (answer.ok) await read();
      return answer;
    },
  });
  node.querySelector(".what")?.after(current);
  return { node, read };
}

/**
 * Return the form of a command or request. Its argument is part of the text (`r<degrees>`) or separate.
 *
 * @param {CommandDescription} command
 * @param {string} verb
 * @param {string} method
 * @param {Call} call
 */
function commandRow(command, verb, method, call) {
  const prefix = /^(.*)<\w+>$/.exec(command.name)?.[1];
  /** @type {Action} */
  const action = (value) =>
    prefix === undefined ? call(method, command.name)(value) : call(method, `${prefix}${value}`)(null);
  return formRow({ ...textsOf(command), verb, action, argument: command.argument });
}

/**
 * Return a command in words: the first clause of its description, the rest of it, and its text for programs.
 *
 * @param {CommandDescription} command
 */
function textsOf({ name, description, argument }) {
  const [first, rest] = splitClause(description);
  const words = capitalised(first.replace(/^Return (the )?/, ""));
  return { words: words || name, more: [rest, argument?.description].filter(Boolean).join(" "), code: name };
}

/**
 * Split a description into its first clause, without the stop behind it, and the rest.
 *
 * @param {string} description
 * @returns {[string, string]}
 */
function splitClause(description) {
  const [, first, rest] = /^(.+?)[.;:](?:\s+(.*))?$/.exec(description) ?? [null, description, ""];
  return [first, capitalised(rest ?? "")];
}

/** @param {string} text */
function capitalised(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** @param {{ words: string, code: string, about: string }} texts */
function describe({ words, code, about }) {
  return el(
    "div",
    { class: "what" },
    words === code ? null : el("span", { class: "words" }, words, " "),
    el("code", {}, code),
    about ? el("span", { class: "about" }, about) : null,
  );
}

/**
 * Return the button of a command without an argument.
 *
 * @param {CommandDescription} command
 * @param {Action} action
 */
function commandButton(command, action) {
  const { words, code } = textsOf(command);
  const button = el(
    "button",
    {
      type: "submit",
      class: command.urgent ? "urgent" : "",
      title: command.description,
      disabled: !store.may("drive"),
    },
    words === code ? null : el("span", {}, words, " "),
    el("code", {}, code),
  );
  return runs(el("form", { class: "command" }, button), action, () => ({ problem: null, value: null }));
}

/** @param {FormOptions} options @returns {FormRow} */
function formRow({ words, more, code, verb, action, argument, isAllowed = store.may("drive") }) {
  const field = argument ? valueField(argument, words) : null;
  const unit = argument?.unit ? el("span", { class: "unit" }, argument.unit) : null;
  const about = [more, argument ? describeInput(argument) : ""].filter(Boolean).join(" · ");
  const form = el(
    "form",
    { class: "form", noValidate: true },
    describe({ words, code, about }),
    el("div", { class: "inputs" }, field?.node, unit),
    el("button", { type: "submit", "aria-label": `${verb}: ${words}`, disabled: !isAllowed }, verb),
  );
  return { node: runs(form, action, field ? field.read : () => ({ problem: null, value: null })) };
}

/**
 * Make a form run an action with what was entered, and show the outcome beneath.
 *
 * @param {HTMLFormElement} form
 * @param {Action} action
 * @param {() => { problem: string } | { problem: null, value: Argument }} read
 */
function runs(form, action, read) {
  const output = el("output", { class: "small" });
  form.append(output);

  /** @param {string} text @param {string} tone */
  function show(text, tone) {
    output.className = `small ${tone}`;
    setText(output, text);
  }

  form.onsubmit = async (event) => {
    event.preventDefault();
    const input = read();
    if (input.problem !== null) {
      show(input.problem, "bad");
      return;
    }
    show("running …", "busy");
    const answer = await action(input.value);
    if (answer.ok) show(answer.value ? `✓ ${answer.value}` : "✓ done", "good");
    else show(`✕ ${answer.error}`, "bad");
  };
  return form;
}
