// The plans of agents that wait for a person. A plan's text comes from a program: it is shown as text, and hides nothing.

import { request } from "./connection.js";
import { el } from "./dom.js";
import { store } from "./store.js";

/** @import { AgentPlan } from "./types" */

const PERIOD_MS = 2000;

/** The plans that wait, each with its text, its steps and the two decisions. Hidden while there are none. */
export class PlansPanel {
  #timer = setInterval(() => this.load(), PERIOD_MS);
  #shown = "";

  constructor() {
    this.list = el("div", { class: "stack" });
    this.problem = el("p", { class: "small", role: "status" });
    const about = el("p", { class: "small faint" }, "An approval is for one run of this text on this fleet.");
    this.node = el(
      "section",
      { class: "panel stack", "aria-label": "Plans of agents", hidden: true },
      el("h2", {}, "Plans of agents"),
      about,
      this.list,
      this.problem,
    );
    this.load();
  }

  async load() {
    if (!store.may("run")) return;
    const answer = await request("plans", {});
    if (!answer.ok) return;
    /** @type {AgentPlan[]} */
    const plans = answer.plans;
    const shown = JSON.stringify(plans);
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.node.hidden = plans.length === 0;
    this.list.replaceChildren(...plans.map((plan) => this.#entry(plan)));
  }

  /** @param {AgentPlan} plan */
  #entry(plan) {
    /** @param {boolean} approve @param {string} label */
    const button = (approve, label) =>
      el(
        "button",
        { type: "button", onclick: () => this.#decide(plan.hash, approve) },
        `${label} ${plan.hash.slice(0, 6)}`,
      );
    const robots = `${plan.robots.join(", ")}; rehearsed: done in ${plan.duration_s.toFixed(1)} s`;
    return el(
      "article",
      { class: "stack", "aria-label": `Plan ${plan.name}` },
      el("strong", {}, plan.name, el("span", { class: "faint small" }, ` by agent ${visible(plan.agent)}`)),
      el("p", { class: "small" }, robots),
      el("p", { class: "small" }, `Parameters: ${visible(JSON.stringify(plan.parameters))}`),
      el(
        "pre",
        { class: "small", tabIndex: 0, "aria-label": "Text of the plan" },
        plan.text.split("\n").map(visible).join("\n"),
      ),
      el("div", { class: "row" }, button(true, "Approve"), button(false, "Refuse")),
    );
  }

  /** @param {string} hash @param {boolean} approve */
  async #decide(hash, approve) {
    const answer = await request("decide", { hash, approve });
    this.problem.textContent = answer.ok ? (approve ? "Approved." : "Refused.") : (answer.error ?? "");
    await this.load();
  }

  leave() {
    clearInterval(this.#timer);
  }
}

/** Return a text in which no character is hidden from a person. @param {string} text */
function visible(text) {
  return text.replace(
    /[\p{C}\u2028\u2029]/gu,
    (one) => `\\u${(one.codePointAt(0) ?? 0).toString(16).padStart(4, "0")}`,
  );
}
