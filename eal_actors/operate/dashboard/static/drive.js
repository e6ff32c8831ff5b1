// Driving by hand. The robot moves only while a key or button is held and this page says so, ten times a second. The
// server halts the robot when these messages stop; the page releases it when it loses the focus or shows another view.

import { send } from "./connection.js";
import { el, setText } from "./dom.js";
import { GamepadReader } from "./gamepad.js";
import { store } from "./store.js";

/** @import { DriveError } from "./types" */
/** @typedef {"ahead" | "back" | "left" | "right"} Direction */

const PERIOD_MS = 100;
/** @type {Record<string, Direction>} */
const KEYS = {
  w: "ahead",
  arrowup: "ahead",
  s: "back",
  arrowdown: "back",
  a: "left",
  arrowleft: "left",
  d: "right",
  arrowright: "right",
};
/** @type {(Direction | null)[]} */
const PAD = [null, "ahead", null, "left", null, "right", null, "back", null];
/** Fields that take letters, and those that take arrow keys. */
const FIELDS = "input:not([type=range]), select, textarea";
const ARROW_FIELDS = "input, select, textarea";
/** Keys that hold a button of the pad that has the focus. */
const PAD_KEYS = [" ", "Enter"];
const SIGNS = { ahead: "▲ W", back: "▼ S", left: "◀ A", right: "D ▶" };
const HINT_ARMED =
  "Hold W A S D or an arrow key, or a gamepad's shoulder button with its left stick. The robot halts when you release it.";
const HINT_UNARMED = "Press the button to drive with keys or a gamepad, or hold an arrow here.";
// Each time that keys are held has a number. Numbers grow, also after a reload of the page.
let lastPress = Date.now();
/** @type {DrivePanel | null} */
let active = null;

export function releaseAll() {
  active?.gamepad.forget();
  active?.release();
}

/**
 * Show an error at the panel that it concerns; return whether one did.
 *
 * @param {DriveError} driveError
 */
export function showDriveError({ error, robot, press }) {
  if (!active || (robot && robot !== active.robot)) return false;
  if (press !== undefined && press !== active.pressNumber) return true; // of keys that were released since
  return active.fail(error) || press !== undefined;
}

window.addEventListener("blur", releaseAll);
window.addEventListener("pagehide", releaseAll);
document.addEventListener("visibilitychange", () => document.hidden && releaseAll());
// A menu takes the keys, so their release would never come.
window.addEventListener("contextmenu", (event) => event.defaultPrevented || releaseAll());

export class DrivePanel {
  /** @type {Set<Direction>} */
  held = new Set();
  /** @type {Map<string, Direction>} By the place of the key: a modifier or a layout may give it another name meanwhile. */
  keys = new Map();
  isArmed = false;
  /** @type {number | null} */
  pressNumber = null;
  /** @type {ReturnType<typeof setInterval> | null} Sends messages while keys are held. */
  timer = null;
  /** Whether an error ended this press: nothing moves until all keys are up and one is pressed again. */
  hasFailed = false;
  /** @type {{ ahead: number, left: number } | null} The stick of a gamepad whose dead-man button is held. */
  stick = null;
  gamepad = new GamepadReader((stick) => this.onStick(stick));
  /** @type {Map<Direction, HTMLButtonElement>} */
  buttons = new Map();

  /** @param {string} robot */
  constructor(robot) {
    this.robot = robot;
    this.status = el("p", { class: "small faint", role: "status" });
    this.arm = el(
      "button",
      { type: "button", "aria-pressed": "false", onclick: () => this.setArmed(!this.isArmed) },
      "Drive with keys",
    );
    this.speed = slider("Speed", "m/s", { min: "0.05", max: "0.5", step: "0.05", value: "0.2" });
    this.turn = slider("Turn", "rad/s", { min: "0.2", max: "2", step: "0.1", value: "0.8" });
    const pad = el("div", { class: "pad", role: "group", "aria-label": "Hold to drive" });
    for (const direction of PAD) pad.append(direction ? this.addButton(direction) : el("span"));
    this.node = el(
      "section",
      { class: "panel stack", "aria-label": "Drive by hand" },
      el("h2", {}, "Drive by hand"),
      this.arm,
      pad,
      this.speed.node,
      this.turn.node,
      this.status,
    );
    window.addEventListener("keydown", this.onKeyDown);
    window.addEventListener("keyup", this.onKeyUp);
    active = this;
    this.showHint();
  }

  /** @param {Direction} direction */
  addButton(direction) {
    const button = el(
      "button",
      { type: "button", "aria-label": `${SIGNS[direction]}: hold to drive ${direction}` },
      SIGNS[direction],
    );
    button.onpointerdown = (event) => {
      event.preventDefault();
      button.setPointerCapture(event.pointerId);
      this.press(direction);
    };
    button.onpointerup = button.onpointercancel = button.onlostpointercapture = () => this.lift(direction);
    button.oncontextmenu = (event) => event.preventDefault();
    button.onkeydown = (event) => {
      if (!PAD_KEYS.includes(event.key)) return;
      event.preventDefault();
      if (!event.repeat) this.press(direction);
    };
    button.onkeyup = (event) => PAD_KEYS.includes(event.key) && this.lift(direction);
    button.onblur = () => this.lift(direction);
    this.buttons.set(direction, button);
    return button;
  }

  leave() {
    this.gamepad.set(false);
    this.release();
    window.removeEventListener("keydown", this.onKeyDown);
    window.removeEventListener("keyup", this.onKeyUp);
    if (active === this) active = null;
  }

  /** @param {boolean} isArmed */
  setArmed(isArmed) {
    this.release();
    this.isArmed = isArmed && store.mayCommand();
    this.gamepad.set(this.isArmed);
    this.arm.setAttribute("aria-pressed", String(this.isArmed));
    this.node.classList.toggle("driving", this.isArmed);
    this.showHint();
  }

  showHint() {
    if (!store.mayCommand()) setText(this.status, "Read only.");
    else setText(this.status, this.isArmed ? HINT_ARMED : HINT_UNARMED);
  }

  /** @param {KeyboardEvent} event */
  onKeyDown = (event) => {
    if (event.key === "Meta") this.release(); // macOS reports no release of other keys while it is held
    const direction = KEYS[event.key.toLowerCase()];
    if (!direction || !this.isArmed || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target instanceof Element && event.target.matches(event.key.length === 1 ? FIELDS : ARROW_FIELDS)) return;
    event.preventDefault();
    if (event.repeat) return;
    this.keys.set(placeOf(event), direction);
    this.press(direction);
  };

  /** @param {KeyboardEvent} event */
  onKeyUp = (event) => {
    const direction = this.keys.get(placeOf(event));
    this.keys.delete(placeOf(event));
    if (direction) this.lift(direction);
  };

  /** @param {Direction} direction */
  press(direction) {
    if (!store.mayCommand()) {
      this.showHint();
      return;
    }
    this.held.add(direction);
    this.showHeld();
    this.begin();
  }

  /** Begin a press, unless there is one or an error ended it, and send. */
  begin() {
    if (this.hasFailed) return;
    if (this.timer === null) {
      this.pressNumber = ++lastPress;
      this.timer = setInterval(() => this.send(), PERIOD_MS);
      setText(this.status, "Driving.");
    }
    this.send();
  }

  /** @param {Direction} direction */
  lift(direction) {
    if (!this.held.delete(direction)) return;
    this.showHeld();
    if (this.held.size === 0 && !this.stick) this.release();
    else if (!this.hasFailed) this.send();
  }

  /** @param {{ ahead: number, left: number } | null} stick */
  onStick(stick) {
    if (!store.mayCommand()) return;
    this.stick = stick;
    if (stick) this.begin();
    else if (this.held.size === 0) this.release();
  }

  send() {
    if (this.pressNumber === null) return;
    const isSent = send({
      do: "drive",
      robot: this.robot,
      press: this.pressNumber,
      speed_m_s: this.axis("ahead", "back", this.stick?.ahead) * this.speed.value(),
      turn_rad_s: this.axis("left", "right", this.stick?.left) * this.turn.value(),
      heard_s: store.heard_s,
    });
    if (!isSent) this.fail("there is no connection");
  }

  /** @param {Direction} plus @param {Direction} minus @param {number} [stick] */
  axis(plus, minus, stick = 0) {
    const keys = Number(this.held.has(plus)) - Number(this.held.has(minus));
    return Math.max(-1, Math.min(1, keys + stick));
  }

  release() {
    if (this.stopTimer()) send({ do: "release", robot: this.robot });
    this.held.clear();
    this.keys.clear();
    this.stick = null;
    if (!this.hasFailed) this.showHint();
    this.hasFailed = false;
    this.showHeld();
  }

  /** @param {string} error */
  fail(error) {
    if (!this.stopTimer()) return false;
    this.hasFailed = true;
    setText(this.status, `Halted: ${error}`);
    return true;
  }

  stopTimer() {
    if (this.timer === null) return false;
    clearInterval(this.timer);
    this.timer = null;
    return true;
  }

  showHeld() {
    for (const [direction, button] of this.buttons) button.classList.toggle("held", this.held.has(direction));
  }
}

/** Return what identifies a key. @param {KeyboardEvent} event */
function placeOf(event) {
  return event.code || event.key.toLowerCase();
}

/** @param {string} label @param {string} unit @param {{ min: string, max: string, step: string, value: string }} range */
function slider(label, unit, range) {
  const output = el("output", { class: "number" });
  const input = el("input", { type: "range", ...range, "aria-label": `${label} in ${unit}`, class: "grow" });
  const show = () => setText(output, `${Number(input.value).toFixed(2)} ${unit}`);
  input.oninput = show;
  show();
  return { node: el("label", {}, el("span", {}, label), input, output), value: () => Number(input.value) };
}
