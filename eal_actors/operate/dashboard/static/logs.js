// The log, filtered by level, robot and text.

import { clockTime, el, setText } from "./dom.js";
import { store } from "./store.js";

/** @import { LogLine, View } from "./types" */

const LEVELS = ["debug", "info", "warning", "error", "critical"];
/** @type {Record<string, string>} */
const SHAPES = { debug: "·", info: "i", warning: "▲", error: "✕", critical: "✕" };
const MAX_LINES = 1000;
const filter = { level: "info", robot: "", text: "" };

/** @param {HTMLElement} root @returns {View} */
export function logsView(root) {
  root.className = "fill";
  const lines = el("div", { class: "panel lines", role: "log", tabIndex: 0, "aria-label": "Log lines" });
  const empty = el("p", { class: "faint", hidden: true });
  const lost = el("span", { class: "chip warn", hidden: true });
  const robots = el("select", { onchange: () => setFilter("robot", robots.value) });
  const levels = el(
    "select",
    { onchange: () => setFilter("level", levels.value) },
    ...LEVELS.slice(1, 4).map((level) =>
      el("option", { value: level, selected: level === filter.level }, `${level} and above`),
    ),
  );
  const search = el("input", {
    type: "search",
    value: filter.text,
    placeholder: "text",
    oninput: () => setFilter("text", search.value),
  });
  root.append(
    el(
      "div",
      { class: "row" },
      el("h1", { class: "grow" }, "Logs ", el("span", { class: "faint small" }, "wall time of this computer")),
      lost,
      el("label", {}, "Level", levels),
      el("label", {}, "Robot", robots),
      el("label", {}, "Contains", search),
    ),
    empty,
    lines,
  );
  /** @type {LogLine | null} */
  let last = null;
  /** @type {string | null} */
  let shownNames = null;

  /** @param {keyof typeof filter} key @param {string} value */
  function setFilter(key, value) {
    filter[key] = value;
    last = null;
    update(new Set(["logs"]));
  }

  /** @type {View["update"]} */
  function update(changed) {
    const names = store.names();
    if (shownNames !== names.join()) {
      shownNames = names.join();
      const options = ["", ...names].map((name) =>
        el("option", { value: name, selected: name === filter.robot }, name || "all"),
      );
      robots.replaceChildren(...options);
    }
    if (!changed.has("logs") && !changed.has("hello")) return;
    const isAtEnd = lines.scrollHeight - lines.scrollTop - lines.clientHeight < 40;
    const start = last ? store.logs.indexOf(last) + 1 : 0;
    const fresh = store.logs.slice(start).filter(passesFilter).map(renderLine);
    if (start === 0) lines.replaceChildren(...fresh);
    else lines.append(...fresh);
    while (lines.children.length > MAX_LINES) lines.firstChild?.remove();
    last = store.logs.at(-1) ?? null;
    empty.hidden = lines.children.length > 0;
    lines.hidden = !empty.hidden;
    setText(
      empty,
      store.logs.length ? "No line passes the filter." : "Nothing has been logged since the dashboard began.",
    );
    lost.hidden = !store.logsLost;
    setText(lost, `${store.logsLost} lines were dropped`);
    if (isAtEnd || start === 0) lines.scrollTop = lines.scrollHeight;
  }
  return { update };
}

/** @param {LogLine} line */
function passesFilter(line) {
  if (LEVELS.indexOf(line.level) < LEVELS.indexOf(filter.level)) return false;
  if (filter.robot && line.robot !== filter.robot) return false;
  return textOf(line).toLowerCase().includes(filter.text.toLowerCase());
}

/** @param {LogLine} line */
function textOf(line) {
  const details = Object.entries(line.details).map(([key, value]) => `${key}=${value}`);
  return [line.text, details.join(" ")].filter(Boolean).join("  ");
}

/** @param {LogLine} line */
function renderLine(line) {
  const time = clockTime(new Date(line.at));
  return el(
    "div",
    { class: "line" },
    el("span", { class: "faint" }, time),
    el("span", { class: line.level }, `${SHAPES[line.level] ?? "?"} ${line.level}`),
    el("span", {}, [line.robot, line.resource].filter(Boolean).join("/")),
    el("span", {}, textOf(line)),
  );
}
