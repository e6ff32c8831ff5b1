// Robots on a map: hulls, headings, the views of their cameras, and trails that fade.

import { colour } from "./dom.js";

/** @import { Point, Pose, Robot, TrailPoint } from "./types" */
/** @typedef {CanvasRenderingContext2D} Context */
/** @typedef {import("./map_layers.js").Frame} Frame */

/** Colours that people with any kind of colour vision tell apart, after Okabe and Ito. */
const COLOURS = ["#0072b2", "#d97a00", "#009e73", "#b3589a", "#3b9bdc", "#d55e00", "#8a8600", "#6b7280"];
/** Size of a robot that is smaller than this on the screen, or whose size is not known. */
export const ARROW_PX = 10;
const LEAST_HULL_PX = 7;
const VIEW_M = 0.9;
const FADE_MS = 60_000;
const FADE_STEPS = 6;
const LEAST_ALPHA = 0.16;
const MOST_ALPHA = 0.75;

/** @param {number} index - of the robot in the fleet. */
export function robotColour(index) {
  return COLOURS[index % COLOURS.length];
}

/** @param {number} scale - pixels of a metre. @param {Robot | undefined} robot */
export function hullPx(scale, robot) {
  return (robot?.radius_m ?? 0) * scale;
}

/**
 * Draw a robot as large as it is. One that may not move, or whose pose is old, is hollow and red.
 *
 * @param {Context} context
 * @param {Frame} frame
 * @param {Pose} pose
 * @param {Robot | undefined} robot
 * @param {string} fill
 * @param {boolean} isMarked
 */
export function drawRobot(context, { scale, toScreen }, pose, robot, fill, isMarked) {
  const isReady = robot?.state === "ready" && !robot.stopped && !robot.pose_seen;
  const floor = colour("--floor");
  const radius = hullPx(scale, robot);
  const size = radius > LEAST_HULL_PX ? radius * 0.62 : Math.max(6, Math.min(ARROW_PX, scale * 0.35));
  context.save();
  context.translate(...toScreen(pose.at[0], pose.at[1]));
  if (isMarked) {
    context.beginPath();
    context.arc(0, 0, Math.max(radius, ARROW_PX) + 6, 0, 2 * Math.PI);
    context.strokeStyle = colour("--accent");
    context.lineWidth = 3;
    context.stroke();
  }
  if (radius > LEAST_HULL_PX) {
    context.beginPath();
    context.arc(0, 0, radius, 0, 2 * Math.PI);
    context.fillStyle = isReady ? fill : floor;
    context.strokeStyle = isReady ? floor : colour("--bad");
    context.lineWidth = isReady ? 1.5 : 2.5;
    context.fill();
    context.stroke();
  }
  context.rotate(-pose.at[2]);
  context.beginPath();
  context.moveTo(size * 1.2, 0);
  context.lineTo(-size * 0.95, size * 0.82);
  context.lineTo(-size * 0.45, 0);
  context.lineTo(-size * 0.95, -size * 0.82);
  context.closePath();
  if (radius > LEAST_HULL_PX) {
    context.fillStyle = isReady ? floor : colour("--bad");
    context.fill();
  } else {
    context.fillStyle = isReady ? fill : floor;
    context.strokeStyle = isReady ? floor : colour("--bad");
    context.lineWidth = isReady ? 1.2 : 2.2;
    context.fill();
    context.stroke();
  }
  context.restore();
}

/**
 * Draw what a robot's camera sees, as a sector that fades.
 *
 * @param {Context} context
 * @param {Frame} frame
 * @param {Pose} pose
 * @param {Robot | undefined} robot
 * @param {string} fill
 */
export function drawView(context, { scale, toScreen }, pose, robot, fill) {
  if (!robot?.view) return;
  const half = (robot.view.fov_deg * Math.PI) / 360;
  const middle = -(pose.at[2] + robot.view.yaw_rad);
  const reach = VIEW_M * scale;
  const [x, y] = toScreen(pose.at[0], pose.at[1]);
  const shade = context.createRadialGradient(x, y, 0, x, y, reach);
  shade.addColorStop(0, `${fill}55`);
  shade.addColorStop(1, `${fill}00`);
  context.fillStyle = shade;
  context.beginPath();
  context.moveTo(x, y);
  context.arc(x, y, reach, middle - half, middle + half);
  context.closePath();
  context.fill();
}

/**
 * Draw a trail; what is older is fainter.
 *
 * @param {Context} context
 * @param {{ toScreen: (x: number, y: number) => Point }} frame
 * @param {TrailPoint[]} points
 * @param {string} stroke
 */
export function drawTrail(context, frame, points, stroke) {
  if (points.length < 2) return;
  const now = performance.now();
  /** @param {TrailPoint} point */
  const stepOf = (point) => Math.min(FADE_STEPS, Math.floor(((now - point[2]) / FADE_MS) * FADE_STEPS));
  context.save();
  context.lineWidth = 2;
  context.lineJoin = "round";
  context.strokeStyle = stroke;
  let start = 0;
  while (start < points.length - 1) {
    const step = stepOf(points[start + 1]);
    let end = start + 1;
    while (end < points.length - 1 && stepOf(points[end + 1]) === step) end += 1;
    context.globalAlpha = Math.max(LEAST_ALPHA, MOST_ALPHA * (1 - step / FADE_STEPS));
    context.beginPath();
    context.moveTo(...frame.toScreen(points[start][0], points[start][1]));
    for (let at = start + 1; at <= end; at += 1) context.lineTo(...frame.toScreen(points[at][0], points[at][1]));
    context.stroke();
    start = end;
  }
  context.restore();
}
