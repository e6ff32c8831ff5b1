// The world from above with the robots and their trails: drag, zoom, click a robot for its panel, or send one.

import { colour, dark, el, fitCanvas, setText } from "./dom.js";
import { PlaybackBar } from "./history.js";
import { icon } from "./icons.js";
import { MapCamera } from "./map_camera.js";
import { FloorPicture } from "./map_floor.js";
import { drawPath, drawSpread, drawWorld, drawZones, rectangleOf } from "./map_layers.js";
import { drawNames } from "./map_names.js";
import { listenTo, ZOOM } from "./map_pointers.js";
import { drawRobot, drawTrail, drawView, hullPx, robotColour } from "./map_robots.js";
import { MapSender } from "./map_send.js";
import { Sheet } from "./map_sheet.js";
import { store, worldBounds } from "./store.js";

/** @import { TrailPoint, View } from "./types" */
/** @typedef {CanvasRenderingContext2D} Context */

const HIT_PX = 18; // a click this near to a robot opens its panel
const MAX_NAMES = 40;
const REDRAW_TRAILS_MS = 1500;
const TICK_MS = 250;
const GRID_M = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50];
const GRID_PX = 34;

/** @param {HTMLElement} root @returns {View} */
export function mapView(root) {
  root.className = "fill";
  const map = new FleetMap();
  root.append(el("h1", { class: "unseen" }, "Map"), map.node);
  map.observe();
  return map;
}

/** Explain why no robot is on the map. */
function explainNoPoses() {
  const names = store.names();
  const away = names.filter((name) => store.robots[name]?.state !== "ready");
  if (!names.length) return "The fleet has no robots yet.";
  if (away.length === names.length)
    return `No robot is ready yet, so none is on the map: ${away.slice(0, 5).join(", ")}.`;
  const waiting = names.filter((name) =>
    ["Pose", "Odometry"].some((resource) => store.robots[name]?.not_ready[resource]),
  );
  if (waiting.length)
    return `No robot knows where it is yet. Their poses are not ready: ${waiting.slice(0, 5).join(", ")}.`;
  return "No robot reports where it is. A robot appears here as soon as it has a resource Pose or Odometry.";
}

/** @param {string} sign @param {string} name @param {() => void} onclick */
function button(sign, name, onclick) {
  return el("button", { type: "button", class: "tool", "aria-label": name, title: name, onclick }, icon(sign));
}

export class FleetMap {
  camera = new MapCamera();
  options = { trails: true, names: true, views: true, picture: true };
  /** @type {string | null} The robot that the pointer is on in a list beside the map. */
  marked = null;
  ground = new Sheet();
  trails = new Sheet();
  /** @type {Map<string, TrailPoint | undefined>} The last point of each trail that is on the sheet of trails. */
  trailEnds = new Map();
  worlds = 0;
  isDue = false;
  hasPoses = false;
  sender = new MapSender(() => this.redraw());
  playback = new PlaybackBar(() => this.redraw());
  floor = new FloorPicture(() => this.redraw());
  observer = new ResizeObserver(() => this.measure());

  constructor() {
    this.canvas = el("canvas", { role: "img", tabIndex: 0 });
    this.extent = el("span", { class: "chip" });
    this.empty = el("div", { class: "no-poses", hidden: true });
    this.frame = el("div", { class: "panel map" }, this.canvas, this.empty, this.extent);
    const tools = el("div", { class: "map-tools" }, this.sender.node, ...this.controls());
    this.node = el("div", { class: "map-stack" }, tools, this.frame, this.playback.node);
    listenTo(this.canvas, {
      pan: (dx, dy) => {
        this.camera.pan(dx, dy);
        this.redraw();
      },
      zoom: (factor, x, y) => this.zoom(factor, x, y),
      fit: () => this.fit(),
      click: (x, y) => this.click(x, y),
    });
    this.sender.offer();
  }

  observe() {
    this.ticker = setInterval(() => this.tick(), TICK_MS);
    this.observer.observe(this.frame);
    dark.addEventListener("change", this.redraw);
    this.measure();
  }

  /** Return the buttons for what is shown, and of how much. */
  controls() {
    return [
      el(
        "span",
        { class: "tools", role: "group", "aria-label": "Layers" },
        this.toggle("trails", "Trails"),
        this.toggle("names", "Names"),
        this.toggle("views", "Views"),
        this.toggle("picture", "Picture"),
      ),
      el(
        "span",
        { class: "tools", role: "group", "aria-label": "Zoom" },
        button("less", "Zoom out", () => this.zoom(1 / ZOOM)),
        button("more", "Zoom in", () => this.zoom(ZOOM)),
        button("fit", "Fit everything", () => this.fit()),
      ),
    ];
  }

  leave() {
    clearInterval(this.ticker);
    this.floor.watch(false);
    this.observer.disconnect();
    dark.removeEventListener("change", this.redraw);
  }

  /** @type {View["update"]} */
  update(changed) {
    const robots = Object.keys(store.poses).length;
    const isFirst = robots > 0 && !this.hasPoses;
    if (changed.has("hello")) this.worlds += 1;
    if (changed.has("hello") || isFirst || (!store.hello?.world && this.camera.isFitted)) {
      this.hasPoses = robots > 0;
      this.fit();
    }
    const label = `Map; robots on it: ${robots}. The fleet view lists them as text.`;
    if (this.canvas.getAttribute("aria-label") !== label) this.canvas.setAttribute("aria-label", label);
    if (changed.has("hello") || changed.has("robots")) this.sender.offer();
    if (changed.has("hello")) this.floor.watched = "";
    this.floor.watch(this.options.picture);
    if (changed.has("poses") || changed.has("robots")) this.draw();
  }

  tick() {
    this.playback.tick();
    if (this.playback.isPlaying) this.redraw();
    const known = Object.keys(store.poses).length > 0;
    this.empty.hidden = known || !store.hello;
    if (!known) setText(this.empty, explainNoPoses());
  }

  /** @param {keyof FleetMap["options"]} key @param {string} label */
  toggle(key, label) {
    const node = el("button", { type: "button", class: "tool", "aria-pressed": "true", "aria-label": label });
    node.title = label;
    node.append(icon(key));
    node.onclick = () => {
      this.options[key] = !this.options[key];
      node.setAttribute("aria-pressed", String(this.options[key]));
      this.floor.watch(this.options.picture);
      this.draw();
    };
    return node;
  }

  measure() {
    this.camera.width = this.frame.clientWidth;
    this.camera.height = this.frame.clientHeight;
    if (this.camera.isFitted) this.fit();
    else this.redraw();
  }

  fit() {
    this.camera.fit(worldBounds());
    this.redraw();
  }

  /** @param {number} factor @param {number} [x] @param {number} [y] */
  zoom(factor, x, y) {
    this.camera.zoom(factor, x, y);
    this.redraw();
  }

  /** Use a click on the floor: send a robot, draw a zone, or open the page of the robot there. @param {number} x @param {number} y */
  click(x, y) {
    const { camera } = this;
    if (this.sender.click(camera.toWorld(x, y), camera.scale)) return;
    const hit = store.names().find((name) => {
      const pose = store.poses[name];
      if (!pose) return false;
      const [robot_x, robot_y] = camera.toScreen(pose.at[0], pose.at[1]);
      return Math.hypot(robot_x - x, robot_y - y) < Math.max(HIT_PX, hullPx(camera.scale, store.robots[name]));
    });
    if (hit) location.hash = `#/robot/${encodeURIComponent(hit)}`;
  }

  // Drawing.

  redraw = () => {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.draw();
    });
  };

  draw() {
    const { camera, floor } = this;
    const { width, height } = camera;
    if (!width || !height) return;
    const context = fitCanvas(this.canvas, width, height);
    const key = [camera.key(), dark.matches, this.worlds, floor.frames, Boolean(floor.image)].join();
    this.ground.show(context, width, height, key, (sheet) => this.drawGround(sheet));
    drawZones(context, camera, [...this.sender.zones, ...(this.sender.drawn ? [this.sender.drawn] : [])]);
    const poses = this.playback.poses(store.poses);
    const isLive = this.playback.shownAt === null;
    if (this.options.trails && isLive) this.drawTrails(context);
    store.names().forEach((name, index) => {
      const stroke = robotColour(index);
      const [pose, robot] = [poses[name], store.robots[name]];
      if (isLive) {
        drawPath(context, camera, name, stroke);
        drawSpread(context, camera, name, stroke);
      }
      if (!pose) return;
      if (this.options.views && isLive) drawView(context, camera, pose, robot, stroke);
      drawRobot(context, camera, pose, robot, stroke, name === this.marked);
    });
    this.frame.classList.toggle("past", !isLive);
    if (this.options.names && store.names().length <= MAX_NAMES) drawNames(context, camera, poses);
    if (this.playback.isPlaying) this.redraw();
  }

  /** @param {Context} context */
  drawGround(context) {
    const { camera, floor } = this;
    const world = store.hello?.world;
    context.fillStyle = colour("--ground");
    context.fillRect(0, 0, camera.width, camera.height);
    if (world) {
      context.fillStyle = colour("--floor");
      context.fillRect(...rectangleOf(camera, world));
      if (floor.image) context.drawImage(floor.image, ...rectangleOf(camera, world));
      this.canvas.dataset.floors = String(floor.frames);
    }
    context.globalAlpha = world && floor.image ? 0.25 : 1;
    this.drawGrid(context);
    context.globalAlpha = 1;
    if (world) drawWorld(context, camera, world);
  }

  /** @param {Context} context */
  drawGrid(context) {
    const { width, height, scale, toScreen } = this.camera;
    const step = GRID_M.find((size) => size * scale > GRID_PX) ?? 50;
    const [left, high] = this.camera.toWorld(0, 0);
    const [right, low] = this.camera.toWorld(width, height);
    context.strokeStyle = colour("--grid");
    context.lineWidth = 1;
    context.beginPath();
    for (let x = Math.ceil(left / step) * step; x < right; x += step) {
      const column = Math.round(toScreen(x, low)[0]) + 0.5;
      context.moveTo(column, 0);
      context.lineTo(column, height);
    }
    for (let y = Math.ceil(low / step) * step; y < high; y += step) {
      const row = Math.round(toScreen(left, y)[1]) + 0.5;
      context.moveTo(0, row);
      context.lineTo(width, row);
    }
    context.stroke();
    const world = store.hello?.world;
    setText(
      this.extent,
      `grid ${step} m · ${world ? `world ${world.name}` : "no world file: scaled to the robots' poses"}`,
    );
  }

  /**
   * Draw the trails. A hundred robots have many points, so they are drawn to a sheet of their own now and then; only
   * newer points are drawn each time.
   *
   * @param {Context} context
   */
  drawTrails(context) {
    const { camera } = this;
    const now = performance.now();
    const key = [camera.key(), this.worlds, Math.floor(now / REDRAW_TRAILS_MS)].join();
    this.trails.show(context, camera.width, camera.height, key, (sheet) =>
      store.names().forEach((name, index) => {
        const points = store.trails[name] ?? [];
        drawTrail(sheet, camera, points, robotColour(index));
        this.trailEnds.set(name, points.at(-1));
      }),
    );
    store.names().forEach((name, index) => {
      const points = store.trails[name];
      const pose = store.poses[name];
      if (!points || !pose) return;
      const end = this.trailEnds.get(name);
      const start = end ? Math.max(points.lastIndexOf(end), 0) : 0;
      drawTrail(context, camera, [...points.slice(start), [pose.at[0], pose.at[1], now]], robotColour(index));
    });
  }
}
