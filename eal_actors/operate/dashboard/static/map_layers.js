// What the map draws besides the robots: the world, zones, places, paths, and how sure the poses are.

import { colour, FONT } from "./dom.js";
import { store } from "./store.js";

/** @import { World, WorldShape, Point } from "./types" */
/** @typedef {CanvasRenderingContext2D} Context */
/** @typedef {{ scale: number, toScreen: (x: number, y: number) => Point }} Frame Pixels of a metre, and of a point. */

const POSTER_COLOUR = "#8c7bb8";
const PLACE_PX = 5;
const SIGMAS = 2.4477; // of an ellipse that holds 95 % of a normal distribution

/** @param {Context} context @param {Frame} frame @param {World} world */
export function drawWorld(context, frame, world) {
  for (const shape of world.shapes) drawShape(context, frame, shape);
  drawZones(context, frame, world.keep_out);
  context.strokeStyle = colour("--wall");
  context.lineWidth = 3;
  context.strokeRect(...rectangleOf(frame, world));
  context.lineWidth = 5;
  context.strokeStyle = POSTER_COLOUR;
  context.beginPath();
  for (const [x0, y0, x1, y1] of world.posters) {
    context.moveTo(...frame.toScreen(x0, y0));
    context.lineTo(...frame.toScreen(x1, y1));
  }
  context.stroke();
  context.strokeStyle = colour("--ink");
  context.lineWidth = 1;
  for (const beacon of world.beacons) {
    context.beginPath();
    context.arc(...frame.toScreen(beacon.x_m, beacon.y_m), 6, 0, 2 * Math.PI);
    context.fillStyle = `rgb(${beacon.colour.join(" ")})`;
    context.fill();
    context.stroke();
  }
  drawPlaces(context, frame, world);
}

/** @param {Frame} frame @param {World} world @returns {[number, number, number, number]} */
export function rectangleOf({ scale, toScreen }, { size_m: [width_m, height_m] }) {
  return [...toScreen(-width_m / 2, height_m / 2), width_m * scale, height_m * scale];
}

/** @param {Context} context @param {Frame} frame @param {WorldShape} shape */
function drawShape(context, { scale, toScreen }, shape) {
  context.save();
  context.translate(...toScreen(shape.x_m, shape.y_m));
  context.beginPath();
  if ("radius_m" in shape) {
    context.arc(0, 0, shape.radius_m * scale, 0, 2 * Math.PI);
  } else {
    const [length, width] = shape.size_m.map((size) => size * scale);
    context.rotate((-shape.yaw_deg * Math.PI) / 180);
    context.rect(-length / 2, -width / 2, length, width);
  }
  context.fillStyle = colour(shape.kind === "drop" ? "--bad-soft" : "--obstacle");
  context.strokeStyle = colour(shape.kind === "drop" ? "--bad" : "--wall");
  context.lineWidth = 1;
  context.setLineDash(shape.kind === "obstacle" ? [] : [4, 3]);
  context.fill();
  context.stroke();
  context.restore();
}

/** @param {Context} context @param {Frame} frame @param {Point[][]} zones */
export function drawZones(context, frame, zones) {
  context.save();
  context.fillStyle = colour("--bad-soft");
  context.strokeStyle = colour("--bad");
  context.lineWidth = 1.5;
  context.setLineDash([6, 4]);
  for (const zone of zones) {
    trace(context, frame, zone);
    if (zone.length > 2) context.closePath();
    context.globalAlpha = 0.6;
    context.fill();
    context.globalAlpha = 1;
    context.stroke();
  }
  context.restore();
}

/** @param {Context} context @param {Frame} frame @param {World} world */
function drawPlaces(context, frame, { places }) {
  context.save();
  context.font = `12px ${FONT}`;
  context.textAlign = "center";
  context.strokeStyle = context.fillStyle = colour("--accent");
  context.lineWidth = 2;
  for (const { x_m, y_m, name } of places) {
    const [x, y] = frame.toScreen(x_m, y_m);
    context.beginPath();
    context.moveTo(x - PLACE_PX, y);
    context.lineTo(x + PLACE_PX, y);
    context.moveTo(x, y - PLACE_PX);
    context.lineTo(x, y + PLACE_PX);
    context.stroke();
    context.save();
    context.strokeStyle = colour("--floor"); // readable on the picture of the floor too
    context.lineWidth = 3;
    context.strokeText(name, x, y + PLACE_PX + 14);
    context.restore();
    context.fillText(name, x, y + PLACE_PX + 14);
  }
  context.restore();
}

/**
 * Draw the planned path of a robot under way, and its goal.
 *
 * @param {Context} context
 * @param {Frame} frame
 * @param {string} name
 * @param {string} stroke
 */
export function drawPath(context, frame, name, stroke) {
  const path = store.paths[name];
  if (!path?.length) return;
  context.save();
  context.strokeStyle = context.fillStyle = stroke;
  context.lineWidth = 2.5;
  context.setLineDash([8, 5]);
  trace(context, frame, path);
  context.stroke();
  context.setLineDash([]);
  context.beginPath();
  context.arc(...frame.toScreen(...path[path.length - 1]), 5, 0, 2 * Math.PI);
  context.fill();
  context.restore();
}

/**
 * Draw the ellipse that has a robot's position with a probability of 95 %.
 *
 * @param {Context} context
 * @param {Frame} frame
 * @param {string} name
 * @param {string} stroke
 */
export function drawSpread(context, { scale, toScreen }, name, stroke) {
  const spread = store.robots[name]?.spread_m2;
  const pose = store.poses[name];
  if (!spread || !pose) return;
  const [xx, xy, yy] = spread;
  const [mean, half] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
  const [long, short] = [mean + half, Math.max(mean - half, 0)].map((part) => SIGMAS * Math.sqrt(part) * scale);
  context.save();
  context.beginPath();
  context.ellipse(...toScreen(pose.at[0], pose.at[1]), long, short, -Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
  context.strokeStyle = stroke;
  context.lineWidth = 1.2;
  context.stroke();
  context.restore();
}

/** @param {Context} context @param {Frame} frame @param {Point[]} points */
function trace(context, { toScreen }, points) {
  context.beginPath();
  points.forEach((point, index) => {
    if (index) context.lineTo(...toScreen(...point));
    else context.moveTo(...toScreen(...point));
  });
}
