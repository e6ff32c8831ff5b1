// The names of robots on a map, each beside its robot and none across another.

import { clockTime, colour, FONT } from "./dom.js";
import { ARROW_PX, hullPx } from "./map_robots.js";
import { stateOf, store } from "./store.js";

/** @import { Pose } from "./types" */
/** @typedef {import("./map_layers.js").Frame} Frame */
/** @typedef {[number, number, number, number]} Box - left, top, right, bottom. */

const HEIGHT_PX = 16;
const PADDING_PX = 5;
const GAP_PX = 4;

/**
 * Write the names above the robots, or below where another name is in the way, or not at all where both are.
 *
 * @param {CanvasRenderingContext2D} context
 * @param {Frame & { width: number }} frame - with the width of the map in pixels.
 * @param {Record<string, Pose>} poses
 */
export function drawNames(context, { scale, toScreen, width }, poses) {
  /** @type {Box[]} */
  const taken = [];
  context.save();
  context.font = `600 12px ${FONT}`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const name of store.names()) {
    const pose = poses[name];
    if (!pose) continue;
    const [at, y] = toScreen(pose.at[0], pose.at[1]);
    if (at < 0 || at > width) continue;
    const [shape, word] = stateOf(store.robots[name]);
    const seen = store.robots[name]?.pose_seen;
    const state = seen && word === "ready" ? `▲ pose of ${clockTime(new Date(seen))}` : `${shape} ${word}`;
    const label = word === "ready" && !seen ? name : `${name} ${state}`;
    const half = context.measureText(label).width / 2 + PADDING_PX;
    const x = Math.max(half, Math.min(width - half, at)); // within the map, at least its beginning
    const away = Math.max(ARROW_PX, hullPx(scale, store.robots[name])) + GAP_PX + HEIGHT_PX / 2;
    const middle = [y - away, y + away].find((height) => {
      const box = boxOf(x, height, half);
      return !taken.some((other) => overlap(box, other));
    });
    if (middle === undefined) continue;
    const box = boxOf(x, middle, half);
    taken.push(box);
    context.globalAlpha = 0.82;
    context.fillStyle = colour("--panel");
    context.beginPath();
    context.roundRect(box[0], box[1], 2 * half, HEIGHT_PX, 4);
    context.fill();
    context.globalAlpha = 1;
    context.fillStyle = colour("--ink");
    context.fillText(label, x, middle + 0.5);
  }
  context.restore();
}

/** @param {number} x @param {number} y @param {number} half @returns {Box} */
function boxOf(x, y, half) {
  return [x - half, y - HEIGHT_PX / 2, x + half, y + HEIGHT_PX / 2];
}

/** @param {Box} one @param {Box} other */
function overlap(one, other) {
  return one[0] < other[2] && other[0] < one[2] && one[1] < other[3] && other[1] < one[3];
}
