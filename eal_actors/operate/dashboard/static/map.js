// The world from above with the robots and their trails: drag, zoom, click a robot for its panel, or send one.

import { colour, el, fitCanvas, setText } from "./dom.js";
import { PlaybackBar } from "./history.js";
import { FloorPicture } from "./map_floor.js";
import { drawPath, drawSpread, drawWorld, drawZones, rectangleOf } from "./map_layers.js";
import { ARROW_PX, drawRobot, drawTrail, drawView, hullPx, robotColour } from "./map_robots.js";
import { MapSender } from "./map_send.js";
import { stateOf, store, worldBounds } from "./store.js";

/** @import { Point, TrailPoint, View } from "./types" */
/** @typedef {CanvasRenderingContext2D} Context */

const HIT_PX = 18; // a click this near to a robot opens its panel
const DRAG_PX = 6; // a pointer that moved farther is no click
const MAX_NAMES = 40;
const REDRAW_TRAILS_MS = 1500;
const TICK_MS = 250;
const ZOOM = 1.3;
const GRID_M = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50];
const GRID_PX = 34;

/** @param {HTMLElement} root @returns {View} */
export function mapView(root) {
  root.className = "fill";
  const map = new FleetMap();
  root.append(
    el(
      "div",
      { class: "stack" },
      el("div", { class: "row" }, el("h1", { class: "grow" }, "Map"), ...map.controls()),
      map.sender.node,
    ),
    map.node,
  );
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

/** @param {string} label @param {string} name @param {() => void} onclick */
function button(label, name, onclick) {
  return el("button", { type: "button", "aria-label": name, title: name, onclick }, label);
}

export class FleetMap {
  /** The point in the middle, in metres, and the pixels of a metre. */
  camera = { x: 0, y: 0, scale: 60, isFitted: true };
  options = { trails: true, names: true, views: true, picture: true };
  /** The robot that the pointer is on in a list beside the map. */
  /** @type {string | null} */
  marked = null;
  trails = document.createElement("canvas");
  /** @type {Map<string, TrailPoint | undefined>} The last point of each trail that is on the canvas of trails. */
  trailEnds = new Map();
  trailsDrawnAt = 0;
  isDue = false;
  hasPoses = false;
  /** @type {Map<number, { x: number, y: number, moved: number }>} Pointers that are down. */
  pointers = new Map();
  pinch = 0;
  sender = new MapSender(() => this.redraw());
  playback = new PlaybackBar(() => this.redraw());
  floor = new FloorPicture(() => this.redraw());
  scheme = matchMedia("(prefers-color-scheme: dark)");
  observer = new ResizeObserver(() => (this.camera.isFitted ? this.fit() : this.redraw()));

  constructor() {
    this.canvas = el("canvas", { role: "img", tabIndex: 0 });
    this.extent = el("span", { class: "chip" });
    this.empty = el("div", { class: "no-poses", hidden: true });
    this.frame = el("div", { class: "panel map" }, this.canvas, this.empty, this.extent);
    this.node = el("div", { class: "map-stack" }, this.frame, this.playback.node);
    this.canvas.onpointerdown = (event) => this.onPointerDown(event);
    this.canvas.onpointermove = (event) => this.onPointerMove(event);
    this.canvas.onpointerup = this.canvas.onpointercancel = (event) => this.onPointerUp(event);
    this.canvas.onwheel = (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY);
    };
    this.canvas.onkeydown = ({ key }) => {
      if (key === "+") this.zoom(ZOOM);
      else if (key === "-") this.zoom(1 / ZOOM);
      else if (key === "0") this.fit();
    };
    this.sender.offer();
  }

  observe() {
    this.ticker = setInterval(() => this.tick(), TICK_MS);
    this.observer.observe(this.frame);
    this.scheme.addEventListener("change", this.redraw);
  }

  /** Return the buttons for what is shown. */
  controls() {
    return [
      this.toggle("trails", "Trails"),
      this.toggle("names", "Names"),
      this.toggle("views", "Views"),
      this.toggle("picture", "Picture"),
      el(
        "span",
        { class: "zoom" },
        button("−", "Zoom out", () => this.zoom(1 / ZOOM)),
        button("+", "Zoom in", () => this.zoom(ZOOM)),
        button("Fit", "Fit everything", () => this.fit()),
      ),
    ];
  }

  leave() {
    clearInterval(this.ticker);
    this.floor.watch(false);
    this.observer.disconnect();
    this.scheme.removeEventListener("change", this.redraw);
  }

  /** @type {View["update"]} */
  update(changed) {
    const robots = Object.keys(store.poses).length;
    const isFirst = robots > 0 && !this.hasPoses;
    if (changed.has("hello") || isFirst || (!store.hello?.world && this.camera.isFitted)) {
      this.hasPoses = robots > 0;
      this.fit();
    }
    this.canvas.setAttribute("aria-label", `Map of ${robots} robots. The fleet view lists them as text.`);
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
    const node = el("button", { type: "button", "aria-pressed": "true" }, label);
    node.onclick = () => {
      this.options[key] = !this.options[key];
      node.setAttribute("aria-pressed", String(this.options[key]));
      this.floor.watch(this.options.picture);
      this.draw();
    };
    return node;
  }

  // The camera.

  /** @param {number} x @param {number} y @returns {Point} - in pixels of the frame. */
  toScreen(x, y) {
    const { clientWidth, clientHeight } = this.frame;
    const { camera } = this;
    return [clientWidth / 2 + (x - camera.x) * camera.scale, clientHeight / 2 - (y - camera.y) * camera.scale];
  }

  /** @param {number} x @param {number} y @returns {Point} - in metres, of a pixel of the frame. */
  toWorld(x, y) {
    const { clientWidth, clientHeight } = this.frame;
    const { camera } = this;
    return [camera.x + (x - clientWidth / 2) / camera.scale, camera.y - (y - clientHeight / 2) / camera.scale];
  }

  fit() {
    const [left, low, right, high] = worldBounds();
    const { clientWidth, clientHeight } = this.frame;
    const scale = Math.min(clientWidth / (right - left), clientHeight / (high - low)) * 0.94;
    this.camera = { x: (left + right) / 2, y: (low + high) / 2, scale: Math.max(1, scale), isFitted: true };
    this.trailsDrawnAt = 0;
    this.redraw();
  }

  /**
   * Zoom around a pixel, which is the middle unless given.
   *
   * @param {number} factor
   * @param {number} [x]
   * @param {number} [y]
   */
  zoom(factor, x = this.frame.clientWidth / 2, y = this.frame.clientHeight / 2) {
    const { camera } = this;
    const [dx, dy] = [x - this.frame.clientWidth / 2, y - this.frame.clientHeight / 2];
    const before = camera.scale;
    camera.scale = Math.min(2000, Math.max(2, before * factor));
    camera.x += dx / before - dx / camera.scale;
    camera.y -= dy / before - dy / camera.scale;
    this.onMoved();
  }

  onMoved() {
    this.camera.isFitted = false;
    this.trailsDrawnAt = 0;
    this.redraw();
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
    const { clientWidth: width, clientHeight: height } = this.frame;
    const context = fitCanvas(this.canvas, width, height);
    const world = store.hello?.world;
    const frame = { scale: this.camera.scale, toScreen: this.toScreen.bind(this) };
    context.fillStyle = colour("--ground");
    context.fillRect(0, 0, width, height);
    if (world) {
      context.fillStyle = colour("--floor");
      context.fillRect(...rectangleOf(frame, world));
      if (this.floor.image) context.drawImage(this.floor.image, ...rectangleOf(frame, world));
      this.canvas.dataset.floors = String(this.floor.frames);
    }
    context.globalAlpha = world && this.floor.image ? 0.25 : 1;
    this.drawGrid(context, width, height);
    context.globalAlpha = 1;
    if (world) drawWorld(context, frame, world);
    drawZones(context, frame, [...this.sender.zones, ...(this.sender.drawn ? [this.sender.drawn] : [])]);
    const poses = this.playback.poses(store.poses);
    const isLive = this.playback.shownAt === null;
    if (this.options.trails && isLive) this.drawTrails(context, width, height);
    store.names().forEach((name, index) => {
      const stroke = robotColour(index);
      const [pose, robot] = [poses[name], store.robots[name]];
      if (isLive) {
        drawPath(context, frame, name, stroke);
        drawSpread(context, frame, name, stroke);
      }
      if (!pose) return;
      if (this.options.views && isLive) drawView(context, frame, pose, robot, stroke);
      drawRobot(context, frame, pose, robot, stroke, name === this.marked);
    });
    this.frame.classList.toggle("past", !isLive);
    if (this.options.names && store.names().length <= MAX_NAMES) this.drawNames(context, poses);
    if (this.playback.isPlaying) this.redraw();
  }

  /** @param {Context} context @param {number} width @param {number} height */
  drawGrid(context, width, height) {
    const { scale, x: middle_x, y: middle_y } = this.camera;
    const step = GRID_M.find((size) => size * scale > GRID_PX) ?? 50;
    const left = middle_x - width / 2 / scale;
    const low = middle_y - height / 2 / scale;
    context.strokeStyle = colour("--grid");
    context.lineWidth = 1;
    context.beginPath();
    for (let x = Math.ceil(left / step) * step; x < left + width / scale; x += step) {
      const column = Math.round(this.toScreen(x, low)[0]) + 0.5;
      context.moveTo(column, 0);
      context.lineTo(column, height);
    }
    for (let y = Math.ceil(low / step) * step; y < low + height / scale; y += step) {
      const row = Math.round(this.toScreen(left, y)[1]) + 0.5;
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
   * Draw the trails. A hundred robots have many points, so they are drawn to a canvas of their own now and then; only
   * newer points are drawn each time.
   *
   * @param {Context} context
   * @param {number} width
   * @param {number} height
   */
  drawTrails(context, width, height) {
    const now = performance.now();
    const size = `${this.canvas.width} ${this.canvas.height}`;
    if (now - this.trailsDrawnAt > REDRAW_TRAILS_MS || this.trails.dataset.size !== size) {
      const sheet = fitCanvas(this.trails, width, height);
      sheet.clearRect(0, 0, width, height);
      store.names().forEach((name, index) => {
        const points = store.trails[name] ?? [];
        drawTrail(sheet, this, points, robotColour(index));
        this.trailEnds.set(name, points.at(-1));
      });
      this.trails.dataset.size = size;
      this.trailsDrawnAt = now;
    }
    if (this.trails.width && this.trails.height) context.drawImage(this.trails, 0, 0, width, height);
    store.names().forEach((name, index) => {
      const points = store.trails[name];
      const pose = store.poses[name];
      if (!points || !pose) return;
      const end = this.trailEnds.get(name);
      const start = end ? Math.max(points.lastIndexOf(end), 0) : 0;
      drawTrail(context, this, [...points.slice(start), [pose.at[0], pose.at[1], now]], robotColour(index));
    });
  }

  /** @param {Context} context @param {Record<string, import("./types").Pose>} poses */
  drawNames(context, poses) {
    context.font = "600 12px system-ui, sans-serif";
    context.textAlign = "center";
    context.lineWidth = 3;
    context.strokeStyle = colour("--floor");
    context.fillStyle = colour("--ink");
    for (const name of store.names()) {
      const pose = poses[name];
      if (!pose) continue;
      const [x, y] = this.toScreen(pose.at[0], pose.at[1]);
      const above = Math.max(ARROW_PX, hullPx(this.camera.scale, store.robots[name])) + 6;
      const [shape, word] = stateOf(store.robots[name]);
      const label = word === "ready" ? name : `${name} ${shape} ${word}`;
      context.strokeText(label, x, y - above);
      context.fillText(label, x, y - above);
    }
  }

  // Pointers: drag, pinch and click.

  /** @param {PointerEvent} event */
  onPointerDown(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY, moved: 0 });
    this.pinch = 0;
  }

  /** @param {PointerEvent} event */
  onPointerMove(event) {
    const pointer = this.pointers.get(event.pointerId);
    if (!pointer) return;
    const dx = event.offsetX - pointer.x;
    const dy = event.offsetY - pointer.y;
    pointer.x = event.offsetX;
    pointer.y = event.offsetY;
    pointer.moved += Math.abs(dx) + Math.abs(dy);
    if (this.pointers.size === 2) {
      const [a, b] = [...this.pointers.values()];
      const distance = Math.hypot(a.x - b.x, a.y - b.y);
      if (this.pinch) this.zoom(distance / this.pinch, (a.x + b.x) / 2, (a.y + b.y) / 2);
      this.pinch = distance;
      return;
    }
    this.camera.x -= dx / this.camera.scale;
    this.camera.y += dy / this.camera.scale;
    this.onMoved();
  }

  /** @param {PointerEvent} event */
  onPointerUp(event) {
    const pointer = this.pointers.get(event.pointerId);
    this.pointers.delete(event.pointerId);
    if (!pointer || pointer.moved > DRAG_PX || event.type !== "pointerup") return;
    if (this.sender.click(this.toWorld(pointer.x, pointer.y), this.camera.scale)) return;
    const hit = store.names().find((name) => {
      const pose = store.poses[name];
      if (!pose) return false;
      const [x, y] = this.toScreen(pose.at[0], pose.at[1]);
      return Math.hypot(x - pointer.x, y - pointer.y) < Math.max(HIT_PX, hullPx(this.camera.scale, store.robots[name]));
    });
    if (hit) location.hash = `#/robot/${encodeURIComponent(hit)}`;
  }
}
