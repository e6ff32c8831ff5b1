// Choose a scenario, carry it out, and watch who does what when.

import { colour, el, fitCanvas, seconds, setText } from "./dom.js";
import { ask } from "./link.js";
import { shortLabel, store } from "./store.js";

const LANE_PX = 24, NAME_PX = 108, AXIS_PX = 22, MOST_NOTES = 200;
const OUTCOMES = { done: ["--accent", ""], failed: ["--bad", "✕ "], dropped: ["--bad", "✕ "], replaced: ["--warn", "▲ "], skipped: ["--warn", "▲ "], aborted: ["--warn", "■ "], stopped: ["--warn", "■ "] };
let lastFile = null;

export function scenarioView(root) {
  const select = el("select", { "aria-label": "Scenario", onchange: () => choose(select.value) });
  const about = el("p", { class: "small faint" });
  const fields = el("div", { class: "stack" });
  const problems = el("ul", { class: "problems small" });
  const start = el("button", { type: "submit", class: "primary" }, "Start");
  const buttons = Object.fromEntries([["pause", "Pause"], ["resume", "Go on"], ["step", "One step"], ["abort", "Abort"]].map(([what, label]) =>
    [what, el("button", { type: "button", onclick: () => control(what) }, label)]));
  const form = el("form", { class: "panel stack", onsubmit: begin }, el("label", { class: "field" }, el("span", {}, "Scenario"), select), about, fields,
    el("div", { class: "row" }, start, ...Object.values(buttons)), problems);
  form.noValidate = true;
  const report = el("a", { target: "_blank", rel: "noopener", hidden: true }, "Report");
  const phase = el("strong", {}), detail = el("span", { class: "faint" }), progress = el("progress", { max: 1, value: 0, "aria-label": "Calls done" });
  const canvas = el("canvas", { role: "img", "aria-label": "Time line of the run" });
  const scroller = el("div", { class: "panel timeline", tabIndex: 0 }, canvas);
  const notes = el("ul", { class: "notes small", "aria-label": "What happened" });
  root.append(el("h1", {}, "Scenario"), el("div", { class: "split" }, form, el("div", { class: "stack" },
    el("div", { class: "panel stack" }, el("div", { class: "row" }, phase, detail, report), progress), scroller, el("div", { class: "panel" }, notes))));
  let scenarios = [], inputs = {}, line = newLine(), seen = null;

  async function list() {
    const answer = await ask({ do: "scenarios" });
    if (!answer.ok) return showProblems([answer.error]);
    scenarios = answer.scenarios;
    select.replaceChildren(...scenarios.map((entry) => el("option", { value: entry.file }, `${entry.name}${entry.problems.length ? " ✕" : ""}`)));
    const file = scenarios.some((entry) => entry.file === lastFile) ? lastFile : (scenarios.find((entry) => !entry.problems.length)?.file ?? "");
    select.value = file;
    choose(file);
  }

  function choose(file) {
    lastFile = file;
    const entry = scenarios.find((candidate) => candidate.file === file);
    setText(about, entry ? `${entry.description ?? ""} (${entry.file})` : "There are no scenarios here.");
    inputs = {};
    fields.replaceChildren(...Object.entries(entry?.parameters ?? {}).map(([name, section]) => {
      inputs[name] = parameterInput(name, section);
      return el("label", { class: "field" }, el("span", {}, name, section.unit ? ` [${section.unit}]` : ""), inputs[name].node,
        el("span", { class: "faint" }, [section.description, range(section)].filter(Boolean).join(" ")));
    }));
    showProblems(entry?.problems ?? []);
    enable();
  }

  function showProblems(texts) {
    problems.replaceChildren(...texts.map((text) => el("li", {}, text)));
  }

  async function begin(event) {
    event.preventDefault();
    const parameters = {};
    for (const [name, input] of Object.entries(inputs)) {
      const [problem, value] = input.read();
      if (problem) return showProblems([`${name} ${problem}`]);
      if (value !== undefined) parameters[name] = value;
    }
    start.disabled = true;
    showProblems([]);
    const answer = await ask({ do: "start", file: select.value, parameters });
    showProblems(answer.ok ? [] : answer.problems?.length ? answer.problems : [answer.error]);
    enable();
  }

  async function control(what) {
    const answer = await ask({ do: "control", what });
    if (!answer.ok) showProblems([answer.error]);
  }

  function enable() {
    const isOn = ["running", "paused"].includes(store.run.phase), may = store.mayCommand();
    start.disabled = isOn || !may || !select.value;
    buttons.pause.disabled = store.run.phase !== "running" || !may;
    buttons.resume.disabled = buttons.step.disabled = store.run.phase !== "paused" || !may;
    buttons.abort.disabled = !isOn || !may;
  }

  function showRun() {
    const run = store.run;
    scroller.hidden = run.phase === "none";
    progress.hidden = run.phase === "none";
    const words = { none: "No run yet", running: "▶ Running", paused: "❚❚ Paused", ended: { done: "✓ Done", failed: "✕ Failed", aborted: "■ Aborted" }[run.outcome] ?? "Ended" };
    setText(phase, words[run.phase] ?? run.phase);
    phase.className = `state ${run.phase === "ended" ? (run.outcome === "done" ? "good" : run.outcome === "failed" ? "bad" : "warn") : ""}`;
    const time = run.phase === "ended" ? run.duration_s : run.started_s === undefined ? null : store.fleetNow() - run.started_s;
    setText(detail, run.phase === "none" ? "" : `${run.scenario} · ${run.done} of ${Math.max(run.calls, run.done)} calls · ${seconds(Math.max(0, time))}${run.error ? ` · ${run.error}` : ""}`);
    report.hidden = !run.report;
    if (run.report) report.href = run.report;
    progress.max = Math.max(run.calls ?? 1, run.done ?? 0, 1);
    progress.value = run.done ?? 0;
    enable();
  }

  function read() {
    const first = store.events[0];
    if (first !== seen || line.count > store.events.length) {
      line = newLine();
      notes.replaceChildren();
      seen = first;
    }
    for (const event of store.events.slice(line.count)) {
      const note = take(line, event);
      if (note) notes.append(el("li", {}, el("span", { class: "faint number" }, `${event.time_s.toFixed(1)} s  `), note));
    }
    line.count = store.events.length;
    while (notes.children.length > MOST_NOTES) notes.firstChild.remove();
    notes.scrollTop = notes.scrollHeight;
    notes.parentNode.hidden = !notes.children.length;
  }

  function update(changed) {
    if (changed.has("hello") && store.hello) list();
    if (changed.has("run") || changed.has("hello")) showRun();
    if (changed.has("events") || changed.has("hello")) {
      read();
      drawLine(canvas, scroller, line);
    }
  }
  const timer = setInterval(() => {
    if (!["running", "paused"].includes(store.run.phase)) return;
    showRun();
    drawLine(canvas, scroller, line);
  }, 150);
  const observer = new ResizeObserver(() => drawLine(canvas, scroller, line));
  observer.observe(scroller);
  read();
  return {
    update,
    leave() {
      clearInterval(timer);
      observer.disconnect();
    },
  };
}

function newLine() {
  return { count: 0, robots: [], bars: new Map(), open: new Map(), end: 1, started: null, isOver: false };
}

// Take in an event; returns a line for people, or null.
function take(line, event) {
  line.end = Math.max(line.end, event.time_s);
  switch (event.event) {
    case "run_started":
      line.robots = event.robots;
      line.started = event.started_s;
      return `${event.scenario} on ${event.robots.length} robots`;
    case "step_started":
      line.open.set(`${event.robot}\n${event.step}`, { start: event.time_s, label: event.label, robot: event.robot });
      return null;
    case "step_ended": {
      const record = event.record;
      line.open.delete(`${record.robot}\n${record.step}`);
      if (!line.bars.has(record.robot)) line.bars.set(record.robot, []);
      line.bars.get(record.robot).push({ start: record.start_s, end: record.end_s, label: record.label, outcome: record.outcome });
      return record.error ? `✕ ${record.robot ?? ""} ${record.label} ${record.outcome}: ${record.error.message}` : null;
    }
    case "step_retried":
      return `▲ ${event.robot ?? ""} ${event.label}: attempt ${event.attempt} failed: ${event.error.message}`;
    case "robot_dropped":
      return `✕ ${event.robot} dropped: ${event.error.message}`;
    case "robot_replaced":
      return `▲ ${event.robot} replaced by ${event.by}: ${event.error.message}`;
    case "log":
      return `${event.robot ?? "scenario"}: ${event.text}`;
    case "run_paused":
      return "paused";
    case "run_resumed":
      return event.is_single_step ? "one step each" : "goes on";
    case "run_ended":
      line.isOver = true;
      return `ended: ${event.report.outcome}`;
    default:
      return null;
  }
}

function drawLine(canvas, scroller, line) {
  const width = scroller.clientWidth, height = AXIS_PX + Math.max(1, line.robots.length) * LANE_PX + 4;
  canvas.style.width = `${width}px`;
  canvas.style.height = `${height}px`;
  const context = fitCanvas(canvas, width, height);
  const end = line.isOver || line.started === null ? line.end : Math.max(line.end, store.fleetNow() - line.started);
  const scale = (width - NAME_PX - 12) / Math.max(end, 1);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  context.textBaseline = "middle";
  const ink = colour("--ink"), faint = colour("--faint"), grid = colour("--line");
  const step = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800].find((size) => size * scale > 60) ?? 3600;
  context.textAlign = "center";
  for (let time = 0; time <= end; time += step) {
    const x = Math.round(NAME_PX + time * scale) + 0.5;
    context.strokeStyle = grid;
    context.beginPath();
    context.moveTo(x, AXIS_PX);
    context.lineTo(x, height);
    context.stroke();
    context.fillStyle = faint;
    context.fillText(`${time} s`, x, AXIS_PX / 2);
  }
  context.textAlign = "left";
  line.robots.forEach((robot, index) => {
    const y = AXIS_PX + index * LANE_PX;
    context.fillStyle = ink;
    context.fillText(clip(context, robot, NAME_PX - 14), 8, y + LANE_PX / 2);
    for (const bar of line.bars.get(robot) ?? []) drawBar(context, bar, y, scale);
  });
  for (const bar of line.open.values()) {
    const index = line.robots.indexOf(bar.robot);
    if (index >= 0) drawBar(context, { ...bar, end, outcome: line.isOver ? "stopped" : null }, AXIS_PX + index * LANE_PX, scale);
  }
}

function drawBar(context, bar, y, scale) {
  const x = NAME_PX + bar.start * scale, width = Math.max(2, (bar.end - bar.start) * scale - 1);
  const [name, shape] = OUTCOMES[bar.outcome] ?? ["--good", "▶ "];
  context.globalAlpha = bar.outcome === null ? 1 : 0.85;
  context.fillStyle = colour(name);
  context.fillRect(x, y + 3, width, LANE_PX - 6);
  context.globalAlpha = 1;
  if (width < 26) return;
  context.fillStyle = colour("--panel");
  const whole = `${shape}${shortLabel(bar.label)}`;
  const text = context.measureText(whole).width <= width - 8 ? whole : `${shape}${bar.label.split(" ").at(-1)}`;
  context.fillText(clip(context, text, width - 8), x + 5, y + LANE_PX / 2);
}

function clip(context, text, width) {
  if (context.measureText(text).width <= width) return text;
  let length = Math.max(0, Math.floor((text.length * width) / context.measureText(text).width) - 1);
  while (length > 0 && context.measureText(`${text.slice(0, length)}…`).width > width) length -= 1;
  return length ? `${text.slice(0, length)}…` : "";
}

function range(section) {
  if (section.choices.length) return `One of ${section.choices.join(", ")}.`;
  if (section.minimum === null && section.maximum === null) return "";
  return `${section.minimum ?? ""} to ${section.maximum ?? ""}${section.unit ? ` ${section.unit}` : ""}.`;
}

// [what is wrong, the value]; undefined leaves the default.
function parameterInput(name, section) {
  const given = section.default === null ? "" : Array.isArray(section.default) ? section.default.join(", ") : String(section.default);
  if (section.choices.length || section.type === "bool") {
    const choices = section.choices.length ? section.choices : [true, false];
    const node = el("select", {}, ...choices.map((choice, index) => el("option", { value: index, selected: String(choice) === given }, String(choice))));
    return { node, read: () => [null, choices[Number(node.value)]] };
  }
  const isNumber = section.type === "int" || section.type === "double";
  const node = el("input", { type: isNumber ? "number" : "text", value: given });
  if (isNumber) node.step = section.type === "int" ? "1" : "any";
  return { node, read() {
    const text = node.value.trim();
    if (text === "") return section.default === null ? ["must be given", undefined] : [null, undefined];
    if (section.type === "list") return [null, text.split(",").map((item) => item.trim()).map((item) => (item !== "" && !Number.isNaN(Number(item)) ? Number(item) : item))];
    if (!isNumber) return [null, node.value];
    const number = Number(text);
    const isWrong = Number.isNaN(number) || (section.type === "int" && !Number.isInteger(number)) ||
      (section.minimum !== null && number < section.minimum) || (section.maximum !== null && number > section.maximum);
    return isWrong ? [`must be ${section.type} ${range(section)}`, undefined] : [null, number];
  } };
}
