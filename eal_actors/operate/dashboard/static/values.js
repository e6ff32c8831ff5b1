// The live values of a robot: a row for each number, with its unit and the line of its last minute.

import { send } from "./connection.js";
import { el, fixed, formatSeconds, setText } from "./dom.js";
import { Sparkline } from "./sparkline.js";
import { store } from "./store.js";

/** @import { LiveValue, ResourceDescription, ValueDescription } from "./types" */
/** @typedef {{ node: HTMLElement, number: HTMLElement, unit: string | null, spark: Sparkline | null }} Row */

const PERIOD_MS = 500;
const LEAST = 0.01; // of a fine unit: a smaller change is drawn as none
const OLD_S = 3; // a stamp that is older is shown
const MAX_ROWS = 4; // numbers of a longer array share a row
const FINE_UNITS = ["m", "rad", "deg", "s", "m/s", "rad/s", "V"]; // a thousandth of them is little
/** @type {Record<string, string>} Units by the end of a number's name. */
const UNITS = { m_s: "m/s", rad_s: "rad/s", deg_s: "deg/s", m: "m", rad: "rad", deg: "deg", s: "s", v: "V", a: "A" };

export class ValuesPanel {
  /** @type {Map<string, Reading>} */
  #readings = new Map();
  #timer = setInterval(() => this.#draw(), PERIOD_MS);

  /** @param {string} robot */
  constructor(robot) {
    this.robot = robot;
    this.list = el("div", { class: "readings" });
    this.hint = el("p", { class: "faint small" }, "Waiting for the first values …");
    this.node = el(
      "section",
      { class: "panel values", "aria-label": "Live values" },
      el("h2", {}, "Live values ", el("span", { class: "faint small" }, "last minute")),
      this.hint,
      this.list,
    );
  }

  /** Ask the server for the values; after each new connection. */
  watch() {
    send({ do: "watch_values", robot: this.robot });
  }

  leave() {
    clearInterval(this.#timer);
    send({ do: "watch_values", robot: null });
  }

  /** @param {ResourceDescription[]} resources */
  describe(resources) {
    this.#readings = new Map(resources.map((info) => [info.name, new Reading(info)]));
    this.list.replaceChildren(...[...this.#readings.values()].map((reading) => reading.node));
    this.update();
  }

  /** Take the newest values from the store. */
  update() {
    const values = store.values[this.robot] ?? {};
    const now = performance.now();
    for (const [name, reading] of this.#readings) reading.take(values[name], now);
    this.hint.hidden = Object.keys(values).length > 0;
    this.#draw();
  }

  #draw() {
    const isReady = store.robots[this.robot]?.state === "ready";
    this.node.classList.toggle("stale", !isReady);
    for (const reading of this.#readings.values()) reading.draw(performance.now(), isReady);
  }
}

/** The value of one resource. */
class Reading {
  /** @type {Row[]} */
  #rows = [];
  /** @type {LiveValue | undefined} */
  #value;

  /** @param {ResourceDescription} info */
  constructor(info) {
    this.info = info;
    this.name = el("span", { class: "name" }, info.name);
    this.note = el("span", { class: "note", hidden: true });
    this.node = el(
      "div",
      { class: "reading", hidden: true, "data-resource": info.name, title: info.description },
      this.name,
    );
    this.node.append(this.note);
  }

  /** @param {LiveValue | undefined} value @param {number} now */
  take(value, now) {
    this.node.hidden = !value;
    if (!value || value === this.#value) return;
    this.#value = value;
    if (value.value === undefined || value.value === null || value.silent_s) return;
    const given = Array.isArray(value.value) ? value.value : [value.value];
    const items = given.length ? given : [null];
    const isOneRow = items.length > MAX_ROWS;
    this.#fit(isOneRow ? 1 : items.length);
    const isWhole = this.info.value?.type === "INT";
    this.#rows.forEach((row, index) => {
      row.spark?.add(now, (isOneRow ? items : [items[index]]).map(numberOf));
      setText(row.number, isOneRow ? spanOf(items, row.unit, isWhole) : textOf(items[index], row.unit, isWhole));
      row.number.classList.toggle("off", items[index] === false);
    });
  }

  /** Make the rows of a value. @param {number} count */
  #fit(count) {
    if (this.#rows.length === count) return;
    for (const row of this.#rows) row.node.remove();
    this.#rows = Array.from({ length: count }, (_, index) => newRow(this.info, index, count));
    this.name.after(...this.#rows.map((row) => row.node));
    this.node.classList.toggle("many", count > 1);
  }

  /** @param {number} now @param {boolean} isReady */
  draw(now, isReady) {
    const value = this.#value;
    if (!value) return;
    const age_s = value.stamp_s == null ? 0 : (store.fleetNow() - value.stamp_s) / (store.hello?.rate ?? 1);
    const note =
      value.error ??
      (value.silent_s
        ? `no answer for ${value.silent_s} s`
        : age_s > OLD_S
          ? `measured ${formatSeconds(age_s)} ago`
          : "");
    this.note.hidden = !note;
    setText(this.note, note);
    this.node.classList.toggle("silent", note !== "");
    for (const row of this.#rows) row.spark?.draw(now, isReady && !note);
  }
}

/** @param {ResourceDescription} info @param {number} index @param {number} count @returns {Row} */
function newRow({ name, value }, index, count) {
  const [label, unit] = (count > 1 && labelsOf(value)[index]) || [
    count > 1 ? String(index + 1) : "",
    value?.unit ?? null,
  ];
  const least = FINE_UNITS.includes(unit ?? "") ? LEAST : 0;
  const isText = value?.type === "CHAR";
  const spark = isText ? null : new Sparkline(`${name} ${label}`.trim(), value?.type === "BOOL", least);
  const number = el("span", { class: isText ? "number text" : "number" });
  const node = el("div", { class: "sample" }, el("span", { class: "label" }, label), spark?.node, number);
  return { node, number, unit, spark };
}

/** @param {unknown} item */
function numberOf(item) {
  return typeof item === "boolean" ? Number(item) : typeof item === "number" ? item : null;
}

/** @param {unknown} item @param {string | null} unit @param {boolean} isWhole */
function textOf(item, unit, isWhole) {
  if (typeof item === "boolean") return item ? "● true" : "○ false";
  if (typeof item === "string") return item || "(empty)";
  if (typeof item !== "number") return "–";
  return `${isWhole ? item : shortNumber(item, unit)}${unit ? ` ${unit}` : ""}`;
}

/** @param {unknown[]} items @param {string | null} unit @param {boolean} isWhole */
function spanOf(items, unit, isWhole) {
  const numbers = items.filter((item) => typeof item === "number");
  if (!numbers.length) return "–";
  return `${textOf(Math.min(...numbers), null, isWhole)} … ${textOf(Math.max(...numbers), unit, isWhole)}`;
}

/** @param {number} value @param {string | null} unit */
function shortNumber(value, unit) {
  const size = Math.abs(value);
  if (size >= 1e6 || (size > 0 && size < 1e-3 && !FINE_UNITS.includes(unit ?? ""))) return value.toExponential(2);
  return fixed(value, size >= 1000 ? 0 : size >= 100 ? 1 : size >= 10 ? 2 : 3);
}

/**
 * Return the labels and units of an array's numbers, from a description such as "x_m, y_m, yaw_rad"; else nothing.
 *
 * @param {ValueDescription | null} info
 * @returns {[string, string | null][]}
 */
function labelsOf(info) {
  const words = info?.description ?? "";
  if (!/^\w+(, \w+)+$/.test(words)) return [];
  return words.split(", ").map((word) => {
    const end = Object.keys(UNITS).find((unit) => word.endsWith(`_${unit}`));
    return end ? [word.slice(0, -end.length - 1), UNITS[end]] : [word, null];
  });
}
