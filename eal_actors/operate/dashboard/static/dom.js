// Helpers for the DOM. Texts of robots and files are always set as text: nothing here takes HTML.

/**
 * Create an element. Properties that are null, undefined or false are left out.
 *
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag
 * @param {import("./types").Properties<Tag>} [properties] - DOM properties, else attributes.
 * @param {...import("./types").Child} children
 * @returns {HTMLElementTagNameMap[Tag]}
 */
export function el(tag, properties, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(properties ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "class") node.className = String(value);
    else if (name in node) Reflect.set(node, name, value);
    else node.setAttribute(name, String(value));
  }
  for (const child of children) if (child) node.append(child);
  return node;
}

/**
 * Return an element of the page's frame, which index.html holds.
 *
 * @template {HTMLElement} [T=HTMLElement]
 * @param {string} id
 * @returns {T}
 */
export function byId(id) {
  const node = document.getElementById(id);
  if (!node) throw new Error(`index.html has no #${id}`);
  return /** @type {T} */ (node);
}

/** @param {Node} node @param {string} text */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/**
 * Format a number with a fixed number of decimals, without a minus before zero.
 *
 * @param {number} value
 * @param {number} decimals
 */
export function fixed(value, decimals) {
  return value.toFixed(decimals).replace(/^-(0\.?0*)$/, "$1");
}

/** @param {number} value - in seconds. */
export function formatSeconds(value) {
  if (value < 10) return `${value.toFixed(1)} s`;
  if (value < 120) return `${Math.round(value)} s`;
  return value < 7200 ? `${Math.round(value / 60)} min` : `${Math.round(value / 3600)} h`;
}

/** @param {Date} date */
export function clockTime(date) {
  return date.toLocaleTimeString([], { hour12: false });
}

/** Of texts on a canvas; the same as in style.css. */
export const FONT = 'Inter, system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
/** Whether the page is dark. */
export const dark = matchMedia("(prefers-color-scheme: dark)");
/** @type {Map<string, string>} Colours that were looked up: a map of a hundred robots asks for some thousand a second. */
const palette = new Map();
dark.addEventListener("change", () => palette.clear());

/** @param {string} name - of a custom property in style.css, such as `--ink`. */
export function colour(name) {
  let value = palette.get(name);
  if (value === undefined) {
    value = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    palette.set(name, value);
  }
  return value;
}

/**
 * Return a function that calls another, at most once in a while: calls in between are made up for by one at its end.
 *
 * @param {() => void} call
 * @param {number} period_ms
 */
export function throttled(call, period_ms) {
  let isWaiting = false;
  let calledAt = -Infinity;
  return () => {
    if (isWaiting) return;
    const left = calledAt + period_ms - performance.now();
    isWaiting = left > 0;
    const run = () => {
      isWaiting = false;
      calledAt = performance.now();
      call();
    };
    if (isWaiting) setTimeout(run, left);
    else run();
  };
}

/** @param {number | null} fraction @param {string} [kind] */
export function meterOf(fraction, kind = "") {
  if (fraction === null) return null;
  const bar = el("span");
  bar.style.width = `${Math.round(fraction * 100)}%`;
  return el("span", { class: `meter ${kind}`, "aria-hidden": "true" }, bar);
}

/** @param {HTMLCanvasElement} canvas */
export function contextOf(canvas) {
  const context = canvas.getContext("2d");
  if (!context) throw new Error("this browser cannot draw on a canvas");
  return context;
}

/**
 * Give a canvas the resolution of the screen, and return its context, which counts CSS pixels.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {number} width
 * @param {number} height
 */
export function fitCanvas(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  const [devicePixelsX, devicePixelsY] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== devicePixelsX || canvas.height !== devicePixelsY) {
    canvas.width = devicePixelsX;
    canvas.height = devicePixelsY;
  }
  const context = contextOf(canvas);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}

/** @param {string} robot */
export function linkToRobot(robot) {
  return el("a", { href: `#/robot/${encodeURIComponent(robot)}` }, robot);
}
