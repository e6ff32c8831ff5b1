// Input fields for values and parameters, which check what a user typed.

import { el } from "./dom.js";

/** @import { Field, Parameter, Value, ValueDescription } from "./types" */

const NUMBERS = ["INT", "FLOAT", "DOUBLE"];

/**
 * Describe a value's type, range and unit as the command line does: `double 0..360 deg`.
 *
 * @param {ValueDescription | null} info
 */
export function describeValue(info) {
  if (!info) return "";
  const parts = [info.type.toLowerCase()];
  if (info.shape.length) parts.push(`(${info.shape.map((size) => size ?? "n").join(", ")})`);
  if (info.minimum !== null || info.maximum !== null) parts.push(`${info.minimum ?? ""}..${info.maximum ?? ""}`);
  if (info.choices.length) parts.push(info.choices.join("|"));
  if (info.unit) parts.push(info.unit);
  if (info.description) parts.push(`(${info.description})`);
  return parts.join(" ");
}

/**
 * Describe in words what may be entered: `0 to 360 deg`.
 *
 * @param {ValueDescription} info
 */
export function describeInput(info) {
  const unit = info.unit ? ` ${info.unit}` : "";
  if (info.shape.length > 1)
    return `rows of ${info.shape[1] ?? "some"} numbers, separated by semicolons${unit && `,${unit}`}`;
  if (info.shape.length) return `${info.shape[0] ?? "some"} numbers, separated by commas${unit && `,${unit}`}`;
  if (info.type === "BOOL") return "true or false";
  if (info.choices.length) return `one of ${info.choices.join(", ")}`;
  if (!NUMBERS.includes(info.type)) return "a text";
  const kind = info.type === "INT" ? "a whole number" : "a number";
  const { minimum, maximum } = info;
  if (minimum !== null && maximum !== null) return `${kind} from ${shown(minimum)} to ${shown(maximum)}${unit}`;
  if (minimum !== null) return `${kind} of at least ${shown(minimum)}${unit}`;
  if (maximum !== null) return `${kind} of at most ${shown(maximum)}${unit}`;
  return `${kind}${unit && ` in${unit}`}`;
}

/** @param {number} limit */
function shown(limit) {
  return String(Number(limit.toFixed(4)));
}

/**
 * Return the field of a command's argument, or of a value to set.
 *
 * @param {ValueDescription} info
 * @param {string} title
 * @returns {Field<Value | number[] | number[][]>}
 */
export function valueField(info, title) {
  if (info.shape.length) return arrayField(info, title);
  if (info.type === "BOOL") return choiceField([true, false], title);
  if (info.choices.length) return choiceField(info.choices, title);
  if (!NUMBERS.includes(info.type)) {
    const node = el("input", { type: "text", "aria-label": title });
    return { node, read: () => ({ problem: null, value: node.value }) };
  }
  const isInteger = info.type === "INT";
  const node = numberInput(isInteger, title);
  if (info.minimum !== null) node.min = String(info.minimum);
  if (info.maximum !== null) node.max = String(info.maximum);
  if (info.minimum !== null && info.maximum !== null)
    node.placeholder = `${shown(info.minimum)} … ${shown(info.maximum)}`;
  return {
    node,
    read() {
      const value = node.valueAsNumber;
      return isInRange(value, info, isInteger)
        ? { problem: null, value }
        : { problem: `must be ${describeInput(info)}` };
    },
  };
}

/** @param {ValueDescription} info @param {string} title @returns {Field<number[] | number[][]>} */
function arrayField(info, title) {
  const [first, second] = info.shape;
  const isFlat = info.shape.length === 1;
  const node = el("input", { type: "text", placeholder: isFlat ? "1, 2, …" : "1, 2; 3, 4; …", "aria-label": title });
  const problem = `must be ${describeInput(info)}`;
  /** @param {number | null | undefined} size @param {unknown[]} items */
  const fits = (size, items) => items.length > 0 && (size === null || size === undefined || size === items.length);
  return {
    node,
    read() {
      const rows = node.value.split(";").map(parseNumbers);
      if (rows.flat().some(Number.isNaN) || info.shape.length > 2) return { problem };
      if (isFlat) return rows.length === 1 && fits(first, rows[0]) ? { problem: null, value: rows[0] } : { problem };
      return fits(first, rows) && rows.every((row) => fits(second, row)) ? { problem: null, value: rows } : { problem };
    },
  };
}

/** @param {string} text */
function parseNumbers(text) {
  return text
    .split(/[\s,]+/)
    .filter(Boolean)
    .map(Number);
}

/**
 * @param {Value[]} choices
 * @param {string} [title]
 * @param {string} [selected]
 * @returns {Field<Value>}
 */
function choiceField(choices, title, selected) {
  const options = choices.map((choice, index) =>
    el("option", { value: String(index), selected: String(choice) === selected }, String(choice)),
  );
  const node = el("select", {}, ...options);
  if (title) node.setAttribute("aria-label", title);
  return { node, read: () => ({ problem: null, value: choices[Number(node.value)] }) };
}

/** @param {boolean} isInteger @param {string} [title] */
function numberInput(isInteger, title) {
  const node = el("input", { type: "number", step: isInteger ? "1" : "any" });
  if (title) node.setAttribute("aria-label", title);
  return node;
}

/**
 * @param {number} value
 * @param {{ minimum: number | null, maximum: number | null }} range
 * @param {boolean} isInteger
 */
function isInRange(value, { minimum, maximum }, isInteger) {
  if (Number.isNaN(value) || (isInteger && !Number.isInteger(value))) return false;
  return (minimum === null || value >= minimum) && (maximum === null || value <= maximum);
}

/** @param {Parameter} section */
export function describeRange(section) {
  if (section.choices.length) return `One of ${section.choices.join(", ")}.`;
  const range = rangeText(section);
  return range && `${range[0].toUpperCase()}${range.slice(1)}.`;
}

/** @param {Parameter} section */
function rangeText({ minimum, maximum, unit }) {
  const suffix = unit ? ` ${unit}` : "";
  if (minimum !== null && maximum !== null) return `${minimum} to ${maximum}${suffix}`;
  if (minimum !== null) return `at least ${minimum}${suffix}`;
  return maximum === null ? "" : `at most ${maximum}${suffix}`;
}

/**
 * Return the field of a scenario's parameter. It reads undefined where the default applies.
 *
 * @param {Parameter} section
 * @returns {Field<Value | Value[] | undefined>}
 */
export function parameterField(section) {
  const initial = Array.isArray(section.default) ? section.default.join(", ") : String(section.default ?? "");
  if (section.choices.length) return choiceField(section.choices, undefined, initial);
  if (section.type === "bool") return choiceField([true, false], undefined, initial);
  const isInteger = section.type === "int";
  const isNumber = isInteger || section.type === "double";
  const node = isNumber ? numberInput(isInteger) : el("input", { type: "text" });
  node.value = initial;
  return {
    node,
    read() {
      const text = node.value.trim();
      if (text === "")
        return section.default === null ? { problem: "must be given" } : { problem: null, value: undefined };
      if (section.type === "list") return { problem: null, value: text.split(",").map(parseItem) };
      if (!isNumber) return { problem: null, value: node.value };
      const value = Number(text);
      return isInRange(value, section, isInteger)
        ? { problem: null, value }
        : { problem: `must be ${section.type} ${rangeText(section)}` };
    },
  };
}

/** @param {string} text @returns {Value} */
function parseItem(text) {
  const item = text.trim();
  return item !== "" && !Number.isNaN(Number(item)) ? Number(item) : item;
}
