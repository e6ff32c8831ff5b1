// The world from above with the robots and their trails: drag, zoom, click a robot for its panel, or send one.

import { colour, el, fitCanvas, setText } from "./dom.js";
import { FloorPicture } from "./map_floor.js";
import { drawPath, drawSpread, drawWorld, drawZones, rectangleOf } from "./map_layers.js";
import { MapSender } from "./map_send.js";
import { stateOf, store, worldBounds } from "./store.js";

/** @import { Point, View } from "./types" */
/** @typedef {CanvasRenderingContext2D} Context */

const HUES = [212, 28, 150, 330, 268, 60, 188, 0];
const ROBOT_PX = 11;
const HIT_PX = 18; // a click this near to a robot opens its panel
const DRAG_PX = 6; // a pointer that moved farther is no click
const MAX_NAMES = 40;
const REDRAW_TRAILS_MS = 1500;
const ZOOM = 1.3;
const GRID_M = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50];
const GRID_PX = 34;

/** @type {FleetMap | null} */
let shown = null;

/** @param {import("./types").FrameHeader} header @param {Blob | null} jpeg */
export function showFloor(header, jpeg) {
  shown?.floor.show(header, jpeg);
}

/** @param {HTMLElement} root @returns {View} */
export function mapView(root) {
  root.className = "fill";
  const map = new FleetMap();
  root.append(
    el(
      "div",
      { class: "stack" },
      el(
        "div",
        { class: "row" },
        el("h1", { class: "grow" }, "Map"),
        map.toggle("trails", "Trails"),
        map.toggle("names", "Names"),
        map.toggle("picture", "Picture"),
        button("−", "Zoom out", () => map.zoom(1 / ZOOM)),
        button("+", "Zoom in", () => map.zoom(ZOOM)),
        button("Fit", "Fit everything", () => map.fit()),
      ),
      map.sender.node,
    ),
    map.frame,
  );
  map.observe();
  shown = map;
  return map;
}

/** @param {string} label @param {string} name @param {() => void} onclick */
function button(label, name, onclick) {
  return el("button", { type: "button", "aria-label": name, title: name, onclick }, label);
}

class FleetMap {
  /** The point in the middle, in metres, and the pixels of a metre. */
  camera = { x: 0, y: 0, scale: 60, isFitted: true };
  options = { trails: true, names: true, picture: true };
  trails = document.createElement("canvas");
  /** @type {Map<string, Point | undefined>} The last point of each trail that is on the canvas of trails. */
  trailEnds = new Map();
  trailsDrawnAt = 0;
  isDue = false;
  hasPoses = false;
  /** @type {Map<number, { x: number, y: number, moved: number }>} Pointers that are down. */
  pointers = new Map();
  pinch = 0;
  sender = new MapSender(() => this.redraw());
  floor = new FloorPicture(() => this.redraw());
  scheme = matchMedia("(prefers-color-scheme: dark)");
  observer = new ResizeObserver(() => (this.camera.isFitted ? this.fit() : this.redraw()));

  constructor() {
    this.canvas = el("canvas", { role: "img", tabIndex: 0 });
    this.extent = el("span", { class: "chip" });
    this.frame = el("div", { class: "panel map" }, this.canvas, this.extent);
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
    this.observer.observe(this.frame);
    this.scheme.addEventListener("change", this.redraw);
  }

  leave() {
    shown = null;
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
    this.drawGrid(context, width, height);
    if (world) drawWorld(context, frame, world);
    drawZones(context, frame, [...this.sender.zones, ...(this.sender.drawn ? [this.sender.drawn] : [])]);
    if (this.options.trails) this.drawTrails(context, width, height);
    store.names().forEach((name, index) => {
      const stroke = `hsl(${HUES[index % HUES.length]} 62% 46%)`;
      drawPath(context, frame, name, stroke);
      drawSpread(context, frame, name, stroke);
      this.drawRobot(context, name, index);
    });
    if (this.options.names && store.names().length <= MAX_NAMES) this.drawNames(context);
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
        this.drawTrail(sheet, points, index);
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
      this.drawTrail(context, [...points.slice(start), [pose.at[0], pose.at[1]]], index);
    });
  }

  /** @param {Context} context @param {Point[]} points @param {number} index */
  drawTrail(context, points, index) {
    if (points.length < 2) return;
    context.lineWidth = 1.6;
    context.lineJoin = "round";
    context.strokeStyle = `hsl(${HUES[index % HUES.length]} 60% 50% / .55)`;
    context.beginPath();
    context.moveTo(...this.toScreen(...points[0]));
    for (const point of points.slice(1)) context.lineTo(...this.toScreen(...point));
    context.stroke();
  }

  /** @param {Context} context @param {string} name @param {number} index */
  drawRobot(context, name, index) {
    const pose = store.poses[name];
    if (!pose) return;
    const robot = store.robots[name];
    const isReady = robot?.state === "ready" && !robot.stopped;
    const size = Math.max(6, Math.min(ROBOT_PX, this.camera.scale * 0.35));
    const floor = colour("--floor");
    context.save();
    context.translate(...this.toScreen(pose.at[0], pose.at[1]));
    context.rotate(-pose.at[2]);
    context.beginPath();
    context.moveTo(size * 1.25, 0);
    context.lineTo(-size, size * 0.85);
    context.lineTo(-size * 0.5, 0);
    context.lineTo(-size, -size * 0.85);
    context.closePath();
    context.fillStyle = isReady ? `hsl(${HUES[index % HUES.length]} 62% 46%)` : floor;
    context.strokeStyle = isReady ? floor : colour("--bad");
    context.lineWidth = isReady ? 1.2 : 2.2;
    context.fill();
    context.stroke();
    context.restore();
  }

  /** @param {Context} context */
  drawNames(context) {
    context.font = "600 12px system-ui, sans-serif";
    context.textAlign = "center";
    context.lineWidth = 3;
    context.strokeStyle = colour("--floor");
    context.fillStyle = colour("--ink");
    for (const name of store.names()) {
      const pose = store.poses[name];
      if (!pose) continue;
      const [x, y] = this.toScreen(pose.at[0], pose.at[1]);
      const [shape, word] = stateOf(store.robots[name]);
      const label = word === "ready" ? name : `${name} ${shape} ${word}`;
      context.strokeText(label, x, y - ROBOT_PX - 6);
      context.fillText(label, x, y - ROBOT_PX - 6);
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
      return Math.hypot(x - pointer.x, y - pointer.y) < HIT_PX;
    });
    if (hit) location.hash = `#/robot/${encodeURIComponent(hit)}`;
  }
}
