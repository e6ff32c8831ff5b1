// The timeline of a run: one row per robot, one bar per step; steps of all robots together have the first row.

import { colour, FONT, fitCanvas } from "./dom.js";
import { shortLabel, store } from "./store.js";

/** @import { RunEvent } from "./types" */
/** @typedef {{ start: number, end: number, label: string, outcome: string | null }} Bar */

const ROW_PX = 24;
const NAME_PX = 108;
const AXIS_PX = 22;
const TICKS_S = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600];
const TICK_PX = 60;
/** @type {Record<string, [string, string]>} Colours and shapes. */
const OUTCOMES = {
  done: ["--accent", ""],
  failed: ["--bad", "✕ "],
  dropped: ["--bad", "✕ "],
  replaced: ["--warn", "▲ "],
  skipped: ["--warn", "▲ "],
  aborted: ["--warn", "■ "],
  stopped: ["--warn", "■ "],
};

/** The steps of a run, by its events. */
export class Timeline {
  /** How many events it holds. */
  count = 0;
  /** @type {string[]} */
  robots = [];
  /** @type {Map<string | null, Bar[]>} */
  bars = new Map();
  /** @type {Map<string, { start: number, label: string, robot: string | null }>} Steps that have not ended. */
  open = new Map();
  end = 1;
  /** @type {number | null} Start of the run, by the fleet's clock. */
  started_s = null;
  isOver = false;

  /**
   * Add an event; return its text for the notes, or null.
   *
   * @param {RunEvent} event
   */
  add(event) {
    this.count += 1;
    this.end = Math.max(this.end, event.time_s);
    if (event.event === "run_started") {
      this.robots = event.robots;
      this.started_s = event.started_s;
    } else if (event.event === "step_started") {
      this.open.set(`${event.robot}\n${event.step}`, { start: event.time_s, label: event.label, robot: event.robot });
    } else if (event.event === "step_ended") {
      const { robot, step, start_s: start, end_s: end, label, outcome } = event.record;
      this.open.delete(`${robot}\n${step}`);
      const bars = this.bars.get(robot) ?? [];
      bars.push({ start, end, label, outcome });
      this.bars.set(robot, bars);
    } else if (event.event === "run_ended") {
      this.isOver = true;
    }
    return noteOf(event);
  }

  /** The rows: null stands for all robots together. @returns {(string | null)[]} */
  rows() {
    const isTogether = this.bars.has(null) || [...this.open.values()].some(({ robot }) => robot === null);
    return isTogether ? [null, ...this.robots] : this.robots;
  }

  /** @param {HTMLCanvasElement} canvas @param {HTMLElement} frame */
  draw(canvas, frame) {
    const rows = this.rows();
    const width = frame.clientWidth;
    const height = AXIS_PX + Math.max(1, rows.length) * ROW_PX + 4;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
    const context = fitCanvas(canvas, width, height);
    const isRunning = !this.isOver && this.started_s !== null;
    const end = isRunning ? Math.max(this.end, store.fleetNow() - (this.started_s ?? 0)) : this.end;
    const scale = (width - NAME_PX - 12) / Math.max(end, 1);
    context.clearRect(0, 0, width, height);
    context.font = `12px ${FONT}`;
    context.textBaseline = "middle";
    drawAxis(context, end, scale, height);
    context.textAlign = "left";
    rows.forEach((robot, index) => {
      const y = AXIS_PX + index * ROW_PX;
      context.fillStyle = colour(robot === null ? "--faint" : "--ink");
      context.fillText(clip(context, robot ?? "together", NAME_PX - 14), 8, y + ROW_PX / 2);
      for (const bar of this.bars.get(robot) ?? []) drawBar(context, bar, y, scale);
      for (const step of this.open.values()) {
        if (step.robot !== robot) continue;
        drawBar(context, { ...step, end, outcome: this.isOver ? "stopped" : null }, y, scale);
      }
    });
  }
}

/** @param {RunEvent} event */
function noteOf(event) {
  switch (event.event) {
    case "run_started":
      return `${event.scenario} on ${event.robots.length} robots`;
    case "step_ended": {
      const { robot, label, outcome, error } = event.record;
      return error ? `✕ ${robot ?? ""} ${label} ${outcome}: ${error.message}` : null;
    }
    case "step_retried":
      return `▲ ${event.robot ?? ""} ${event.label}: attempt ${event.attempt} failed: ${event.error.message}`;
    case "robot_dropped":
      return `✕ ${event.robot} dropped: ${event.error.message}`;
    case "robot_lost":
      return `▲ ${event.robot} lost: ${event.error.message}`;
    case "robot_returned":
      return `${event.robot} is back`;
    case "robot_replaced":
      return `▲ ${event.robot} replaced by ${event.by}: ${event.error.message}`;
    case "log":
      return `${event.robot ?? "scenario"}: ${event.text}`;
    case "run_paused":
      return "paused";
    case "run_resumed":
      return event.is_single_step ? "each robot runs one step" : "resumed";
    case "run_ended":
      return `ended: ${event.report.outcome}`;
    default:
      return null;
  }
}

/** @param {CanvasRenderingContext2D} context @param {number} end @param {number} scale @param {number} height */
function drawAxis(context, end, scale, height) {
  const step = TICKS_S.find((size) => size * scale > TICK_PX) ?? 3600;
  context.textAlign = "center";
  context.strokeStyle = colour("--line");
  context.fillStyle = colour("--faint");
  for (let time = 0; time <= end; time += step) {
    const x = Math.round(NAME_PX + time * scale) + 0.5;
    context.beginPath();
    context.moveTo(x, AXIS_PX);
    context.lineTo(x, height);
    context.stroke();
    context.fillText(`${time} s`, x, AXIS_PX / 2);
  }
  context.textAlign = "left";
  context.fillText("fleet time", 8, AXIS_PX / 2);
}

/** @param {CanvasRenderingContext2D} context @param {Bar} bar @param {number} y @param {number} scale */
function drawBar(context, bar, y, scale) {
  const x = NAME_PX + bar.start * scale;
  const width = Math.max(2, (bar.end - bar.start) * scale - 1);
  const [colourName, shape] = OUTCOMES[bar.outcome ?? ""] ?? ["--good", "▶ "];
  context.globalAlpha = bar.outcome === null ? 1 : 0.85;
  context.fillStyle = colour(colourName);
  context.beginPath();
  context.roundRect(x, y + 2, width, ROW_PX - 4, Math.min(4, width / 2));
  context.fill();
  context.globalAlpha = 1;
  if (width < 26) return;
  context.fillStyle = colour("--panel");
  const label = `${shape}${shortLabel(bar.label)}`;
  const isShort = context.measureText(label).width <= width - 8;
  const text = isShort ? label : `${shape}${bar.label.split(" ").at(-1)}`;
  context.fillText(clip(context, text, width - 8), x + 5, y + ROW_PX / 2);
}

/** @param {CanvasRenderingContext2D} context @param {string} text @param {number} width */
function clip(context, text, width) {
  const whole = context.measureText(text).width;
  if (whole <= width) return text;
  let length = Math.max(0, Math.floor((text.length * width) / whole) - 1);
  while (length > 0 && context.measureText(`${text.slice(0, length)}…`).width > width) length -= 1;
  return length ? `${text.slice(0, length)}…` : "";
}
