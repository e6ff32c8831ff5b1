// Driving by hand. Motion lasts only while a key or button is held and this page says so, ten times a second: the
// server halts the robot when it hears nothing for a moment, and so does this page when it is left.

import { el, setText } from "./dom.js";
import { say } from "./link.js";
import { store } from "./store.js";

const PERIOD_MS = 100;
const KEYS = { w: "ahead", arrowup: "ahead", s: "back", arrowdown: "back", a: "left", arrowleft: "left", d: "right", arrowright: "right" };
const PAD = [[null, "ahead", null], ["left", null, "right"], [null, "back", null]];
const SIGNS = { ahead: "▲ W", back: "▼ S", left: "◀ A", right: "D ▶" };
let grips = Date.now(), active = null;

// What has been pressed is let go, whatever happens to the page.
export function releaseAll() {
  active?.release();
}

// Something went wrong while driving; returns whether it was shown.
export function troubled(trouble) {
  if (!active || (trouble.robot && trouble.robot !== active.robot)) return false;
  if (trouble.grip !== undefined && trouble.grip !== active.grip) return true; // of keys that were let go since
  return active.trouble(trouble.error) || trouble.grip !== undefined;
}

window.addEventListener("blur", releaseAll);
window.addEventListener("pagehide", releaseAll);
document.addEventListener("visibilitychange", () => document.hidden && releaseAll());

export class Drive {
  constructor(robot) {
    Object.assign(this, { robot, held: new Set(), isArmed: false, grip: null, timer: null, isSpent: false });
    this.status = el("p", { class: "small faint", role: "status" });
    this.arm = el("button", { type: "button", "aria-pressed": "false", onclick: () => this.setArmed(!this.isArmed) }, "Drive with keys");
    this.speed = range("Speed", 0.05, 0.5, 0.05, 0.2, "m/s");
    this.turn = range("Turn", 0.2, 2, 0.1, 0.8, "rad/s");
    this.buttons = {};
    const pad = el("div", { class: "pad", role: "group", "aria-label": "Hold to drive" });
    for (const name of PAD.flat()) pad.append(name ? this.button(name) : el("span"));
    this.node = el("section", { class: "panel stack", "aria-label": "Drive by hand" }, el("h2", {}, "Drive by hand"), this.arm, pad,
      this.speed.node, this.turn.node, this.status);
    this.down = (event) => this.key(event, true);
    this.up = (event) => this.key(event, false);
    window.addEventListener("keydown", this.down);
    window.addEventListener("keyup", this.up);
    active = this;
    this.tell();
  }

  button(name) {
    const button = el("button", { type: "button", "aria-label": `Hold to drive ${name}` }, SIGNS[name]);
    button.onpointerdown = (event) => {
      event.preventDefault();
      button.setPointerCapture(event.pointerId);
      this.press(name);
    };
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(kind, () => this.lift(name));
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    this.buttons[name] = button;
    return button;
  }

  leave() {
    this.release();
    window.removeEventListener("keydown", this.down);
    window.removeEventListener("keyup", this.up);
    if (active === this) active = null;
  }

  setArmed(isArmed) {
    this.release();
    this.isArmed = isArmed && store.mayCommand();
    this.arm.setAttribute("aria-pressed", String(this.isArmed));
    this.node.classList.toggle("driving", this.isArmed);
    this.tell();
  }

  tell(text = null) {
    setText(this.status, text ?? (!store.mayCommand() ? "Read only." : this.isArmed
      ? "Hold W A S D or the arrow keys. Letting go halts the robot." : "Press the button to drive with W A S D or the arrow keys, or hold the arrows here."));
  }

  key(event, isDown) {
    const name = KEYS[event.key.toLowerCase()];
    if (!name) return;
    if (!isDown) return this.lift(name);
    const target = event.target;
    if (!this.isArmed || event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(target.tagName)) return;
    event.preventDefault();
    if (!event.repeat) this.press(name);
  }

  press(name) {
    if (!store.mayCommand()) return this.tell();
    this.held.add(name);
    this.show();
    if (this.isSpent || this.timer !== null) {
      if (!this.isSpent) this.send();
      return;
    }
    this.grip = ++grips;
    this.timer = setInterval(() => this.send(), PERIOD_MS);
    this.tell("Driving.");
    this.send();
  }

  lift(name) {
    if (!this.held.delete(name)) return;
    this.show();
    if (this.held.size === 0) this.release();
    else if (!this.isSpent) this.send();
  }

  send() {
    const axis = (plus, minus) => Number(this.held.has(plus)) - Number(this.held.has(minus));
    const message = { do: "drive", robot: this.robot, grip: this.grip,
      speed_m_s: axis("ahead", "back") * this.speed.value(), turn_rad_s: axis("left", "right") * this.turn.value() };
    if (!say(message)) this.trouble("there is no connection");
  }

  release() {
    if (this.timer !== null) {
      clearInterval(this.timer);
      this.timer = null;
      say({ do: "let_go", robot: this.robot });
    }
    this.held.clear();
    if (!this.isSpent) this.tell();
    this.isSpent = false;
    this.show();
  }

  // The grip has ended: nothing moves until all keys are up and one is pressed anew.
  trouble(text) {
    if (this.timer === null) return false;
    clearInterval(this.timer);
    this.timer = null;
    this.isSpent = true;
    this.tell(`Halted: ${text}`);
    return true;
  }

  show() {
    for (const [name, button] of Object.entries(this.buttons)) button.classList.toggle("held", this.held.has(name));
  }
}

function range(label, min, max, step, value, unit) {
  const shown = el("output", { class: "number" });
  const input = el("input", { type: "range", min, max, step, "aria-label": `${label} in ${unit}`, class: "grow" });
  input.value = value;
  const show = () => setText(shown, `${Number(input.value).toFixed(2)} ${unit}`);
  input.oninput = show;
  show();
  return { node: el("label", {}, el("span", {}, label), input, shown), value: () => Number(input.value) };
}
