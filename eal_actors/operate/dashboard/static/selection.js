// Commands to several robots: those that all of them know, with a form from the declared argument.

import { request } from "./connection.js";
import { el, setText } from "./dom.js";
import { describeValue, valueField } from "./fields.js";
import { store } from "./store.js";

/** @import { CommandDescription, Field, Value } from "./types" */
/** @typedef {{ resource: string, command: CommandDescription }} Choice */

const MAX_FAILURES = 3;

export class SelectionBar {
  /** @type {string[]} */
  robots = [];
  /** @type {Choice[]} */
  choices = [];
  /** @type {Field<Value | number[] | number[][]> | null} */
  field = null;
  count = el("strong");
  command = el("select", { "aria-label": "Command" });
  inputs = el("span", { class: "row" });
  send = el("button", { type: "submit", class: "primary" }, "Send");
  halt = el("button", { type: "button" }, "Halt");
  none = el("button", { type: "button" }, "Clear selection");
  output = el("output", { class: "small grow" });
  form = el("form", { class: "row", noValidate: true }, this.command, this.inputs, this.send);
  node = el(
    "div",
    { class: "panel row selection", hidden: true },
    this.count,
    this.form,
    this.halt,
    this.none,
    this.output,
  );
  #described = "";

  /** @param {() => void} onClear */
  constructor(onClear) {
    this.none.onclick = onClear;
    this.command.onchange = () => this.showField();
    this.halt.onclick = () => this.run("", "halt");
    this.form.onsubmit = (event) => {
      event.preventDefault();
      this.submit();
    };
  }

  /** @param {string[]} robots */
  show(robots) {
    this.robots = robots;
    this.node.hidden = !robots.length;
    setText(this.count, `${robots.length} selected`);
    this.send.disabled = this.halt.disabled = !store.mayCommand();
    if (robots.length) this.describe();
  }

  /** Offer the commands that the selected robots have in common; those of one type have the same. */
  async describe() {
    const types = new Map(
      this.robots.map((name) => [`${store.robots[name]?.type} ${store.robots[name]?.resources}`, name]),
    );
    const key = [...types.keys()].sort().join();
    if (key === this.#described) return;
    this.#described = key;
    const answers = await Promise.all([...types.values()].map((robot) => request("describe", { robot })));
    if (key !== this.#described) return;
    const described = answers.map((answer) => (answer.ok ? answer.resources : []));
    const [first, ...others] = described.map((resources) =>
      resources.flatMap(({ name, commands }) => commands.map((command) => ({ resource: name, command }))),
    );
    this.choices = (first ?? []).filter(({ resource, command }) =>
      others.every((list) => list.some((other) => other.resource === resource && other.command.name === command.name)),
    );
    this.command.replaceChildren(
      ...this.choices.map(({ resource, command }, index) =>
        el("option", { value: String(index) }, `${resource}: ${wordsOf(command)}`),
      ),
    );
    this.form.hidden = !this.choices.length;
    this.showField();
  }

  showField() {
    const { command } = this.choices[Number(this.command.value)] ?? {};
    const argument = command?.argument ?? null;
    this.field = argument ? valueField(argument, wordsOf(command)) : null;
    this.inputs.replaceChildren(
      ...(this.field ? [this.field.node, el("span", { class: "faint" }, argument?.unit)] : []),
    );
    this.inputs.title = describeValue(argument);
  }

  async submit() {
    const choice = this.choices[Number(this.command.value)];
    if (!choice) return;
    const input = this.field?.read() ?? { problem: null, value: null };
    if (input.problem !== null) {
      this.report(input.problem, "bad");
      return;
    }
    const prefix = /^(.*)<\w+>$/.exec(choice.command.name)?.[1];
    const text = prefix === undefined ? choice.command.name : `${prefix}${input.value}`;
    await this.run(choice.resource, text, prefix === undefined ? input.value : null);
  }

  /** @param {string} resource @param {string} text @param {Value | number[] | number[][] | null} [value] */
  async run(resource, text, value = null) {
    const robots = [...this.robots];
    this.report(`${text} to ${robots.length} robots …`, "");
    const answer = await request("command", { robots, resource, text, value });
    if (answer.ok) {
      this.report(`✓ ${text}: ${robots.length} of ${robots.length} robots done`, "good");
      return;
    }
    const failed = Object.entries(answer.failed ?? {});
    const reasons = failed.slice(0, MAX_FAILURES).map(([name, reason]) => `${name}: ${reason}`);
    if (failed.length > MAX_FAILURES) reasons.push(`and ${failed.length - MAX_FAILURES} more`);
    const done = robots.length - failed.length;
    this.report(`✕ ${text}: ${done} of ${robots.length} done. ${reasons.join("; ") || answer.error}`, "bad");
  }

  /** @param {string} text @param {string} tone */
  report(text, tone) {
    this.output.className = `small grow ${tone}`;
    setText(this.output, text);
  }
}

/** Return a command in words, from its description. @param {CommandDescription} command */
function wordsOf({ name, description }) {
  return description ? `${description.replace(/\.$/, "")} (${name})` : name;
}
