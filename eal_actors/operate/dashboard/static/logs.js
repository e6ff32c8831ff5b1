// The log, filtered by level, robot and text.

import { el, setText } from "./dom.js";
import { store } from "./store.js";

const LEVELS = ["debug", "info", "warning", "error", "critical"];
const SHAPES = { debug: "·", info: "i", warning: "▲", error: "✕", critical: "✕" };
const filter = { level: "info", robot: "", text: "" };

export function logsView(root) {
  root.className = "fill";
  const lines = el("div", { class: "panel lines", role: "log", tabIndex: 0, "aria-label": "Log lines" });
  const lost = el("span", { class: "chip warn", hidden: true });
  const robots = el("select", { onchange: () => set("robot", robots.value) });
  const levels = el("select", { onchange: () => set("level", levels.value) },
    ...LEVELS.slice(1, 4).map((level) => el("option", { value: level, selected: level === filter.level }, `${level} and above`)));
  const search = el("input", { type: "search", value: filter.text, placeholder: "text", oninput: () => set("text", search.value) });
  root.append(el("div", { class: "row" }, el("h1", { class: "grow" }, "Logs"), lost,
    el("label", {}, "Level", levels), el("label", {}, "Robot", robots), el("label", {}, "Contains", search)), lines);
  let last = null, known = null;

  function set(key, value) {
    filter[key] = value;
    last = null;
    update(new Set(["logs"]));
  }

  function update(changed) {
    if (known !== store.names().join()) {
      known = store.names().join();
      robots.replaceChildren(...["", ...store.names()].map((name) => el("option", { value: name, selected: name === filter.robot }, name || "all")));
    }
    if (!changed.has("logs") && !changed.has("hello")) return;
    const isAtEnd = lines.scrollHeight - lines.scrollTop - lines.clientHeight < 40;
    const start = last ? store.logs.indexOf(last) + 1 : 0;
    const fresh = store.logs.slice(start).filter(fits).map(lineOf);
    if (start === 0) lines.replaceChildren(...fresh);
    else lines.append(...fresh);
    while (lines.children.length > 1000) lines.firstChild.remove();
    last = store.logs.at(-1) ?? null;
    lost.hidden = !store.logsLost;
    setText(lost, `${store.logsLost} lines were dropped`);
    if (isAtEnd || start === 0) lines.scrollTop = lines.scrollHeight;
  }
  return { update };
}

function fits(line) {
  if (LEVELS.indexOf(line.level) < LEVELS.indexOf(filter.level)) return false;
  if (filter.robot && line.robot !== filter.robot) return false;
  return !filter.text || textOf(line).toLowerCase().includes(filter.text.toLowerCase());
}

function textOf(line) {
  const details = Object.entries(line.details).map(([key, value]) => `${key}=${value}`).join(" ");
  return `${line.text}${details ? `  ${details}` : ""}`;
}

function lineOf(line) {
  const time = new Date(line.at).toLocaleTimeString([], { hour12: false });
  return el("div", { class: "line" }, el("span", { class: "faint" }, time),
    el("span", { class: line.level }, `${SHAPES[line.level] ?? "?"} ${line.level}`),
    el("span", {}, [line.robot, line.resource].filter(Boolean).join("/")), el("span", {}, textOf(line)));
}
