// Sparklines: the numbers of the last minute, as a line of SVG.

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 120;
const HEIGHT = 24;
const EDGE = 2;
const LEAST_SHARE = 0.01; // of the size of the numbers
/** The time that a line shows, in milliseconds. */
export const WINDOW_MS = 60_000;

/** @typedef {{ at: number, value: number | null }} Sample - `at` in milliseconds; null breaks the line. */

/** The latest numbers of one or several series, and their picture. Several series have one scale. */
export class Sparkline {
  /** @type {Sample[][]} */
  #series = [];
  /** @type {SVGPathElement[]} */
  #paths = [];

  /**
   * @param {string} label
   * @param {boolean} isStepped - for values that jump, such as true and false.
   * @param {number} least - the least height of the picture, in the unit of the numbers: noise below it looks flat.
   */
  constructor(label, isStepped, least) {
    this.isStepped = isStepped;
    this.least = least;
    this.node = document.createElementNS(SVG, "svg");
    for (const [name, value] of Object.entries({
      class: "spark",
      viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
      preserveAspectRatio: "none",
      role: "img",
      "aria-label": `${label} in the last minute`,
    })) {
      this.node.setAttribute(name, value);
    }
  }

  /**
   * Add a sample of every series.
   *
   * @param {number} at
   * @param {(number | null)[]} values
   */
  add(at, values) {
    while (this.#series.length < values.length) {
      this.#series.push([]);
      const path = document.createElementNS(SVG, "path");
      path.setAttribute("vector-effect", "non-scaling-stroke");
      this.#paths.push(path);
      this.node.append(path);
    }
    this.#series.forEach((samples, index) => {
      samples.push({ at, value: values[index] ?? null });
      while (samples.length > 1 && samples[1].at < at - WINDOW_MS) samples.shift();
    });
  }

  /**
   * Draw the minute that ends at a time. The newest value holds until then if it is current.
   *
   * @param {number} now
   * @param {boolean} isCurrent
   */
  draw(now, isCurrent) {
    const range = rangeOf(this.#series, this.least);
    this.#series.forEach((samples, index) => {
      this.#paths[index].setAttribute("d", pathOf(samples, range, now, this.isStepped, isCurrent));
    });
    this.node.dataset.samples = String(this.#series[0]?.length ?? 0);
  }
}

/** @param {Sample[][]} series @param {number} least @returns {[number, number]} */
function rangeOf(series, least) {
  let [low, high] = [Infinity, -Infinity];
  for (const { value } of series.flat()) {
    if (value === null) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  const missing = Math.max(0, Math.max(least, LEAST_SHARE * Math.abs(high)) - (high - low));
  return [low - missing / 2, high + missing / 2];
}

/** @param {Sample[]} samples @param {[number, number]} range @param {number} now @param {boolean} isStepped @param {boolean} isCurrent */
function pathOf(samples, [low, high], now, isStepped, isCurrent) {
  const x = (/** @type {number} */ at) => Math.max(0, WIDTH * (1 - (now - at) / WINDOW_MS)).toFixed(1);
  const y = (/** @type {number} */ value) => {
    const share = high > low ? (value - low) / (high - low) : 0.5;
    return (HEIGHT - EDGE - share * (HEIGHT - 2 * EDGE)).toFixed(1);
  };
  let path = "";
  let isDrawn = false;
  for (const { at, value } of samples) {
    if (value !== null) {
      if (!isDrawn) path += `M${x(at)} ${y(value)}`;
      else if (isStepped) path += `H${x(at)}V${y(value)}`;
      else path += `L${x(at)} ${y(value)}`;
    }
    isDrawn = value !== null;
  }
  return isDrawn && isCurrent ? `${path}H${WIDTH}` : path;
}
