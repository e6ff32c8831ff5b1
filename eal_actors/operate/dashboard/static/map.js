// The arena from above: what the world file says, where the robots are, and where they were.

import { colour, el, fitCanvas, setText } from "./dom.js";
import { stateOf, store } from "./store.js";

const HUES = [212, 28, 150, 330, 268, 60, 188, 0];
const ROBOT_PX = 11, MOST_NAMES = 40, REDRAW_TRAILS_MS = 1500;

export function mapView(root) {
  root.className = "fill";
  const canvas = el("canvas", { role: "img", tabIndex: 0 });
  const extent = el("span", { class: "chip" });
  const options = { trails: true, names: true };
  const toggle = (key, label) => {
    const button = el("button", { type: "button", "aria-pressed": "true", onclick: () => {
      options[key] = !options[key];
      button.setAttribute("aria-pressed", String(options[key]));
      draw();
    } }, label);
    return button;
  };
  const plain = (label, name, action) => el("button", { type: "button", "aria-label": name, title: name, onclick: action }, label);
  const frame = el("div", { class: "panel map" }, canvas, extent);
  root.append(
    el("div", { class: "row" }, el("h1", { class: "grow" }, "Map"), toggle("trails", "Trails"), toggle("names", "Names"),
      plain("−", "Zoom out", () => zoom(1 / 1.3)), plain("+", "Zoom in", () => zoom(1.3)), plain("Fit", "Show everything", () => fit())),
    frame);
  const camera = { x: 0, y: 0, scale: 60, isFitted: true };
  const trails = document.createElement("canvas");
  const sheetEnds = {};  // the last point of each trail that is on the sheet
  let trailsAt = 0, isDue = false;

  // Places.
  const toScreen = (x, y) => [frame.clientWidth / 2 + (x - camera.x) * camera.scale, frame.clientHeight / 2 - (y - camera.y) * camera.scale];

  const corner = (arena) => toScreen(-arena.size_m[0] / 2, arena.size_m[1] / 2);

  function bounds() {
    const arena = store.hello?.arena;
    if (arena) return [-arena.size_m[0] / 2, -arena.size_m[1] / 2, arena.size_m[0] / 2, arena.size_m[1] / 2];
    const points = [...Object.values(store.poses).map((pose) => pose.at), ...Object.values(store.trails).flat()];
    if (!points.length) return [-2, -1.5, 2, 1.5];
    const xs = points.map((point) => point[0]), ys = points.map((point) => point[1]);
    const least = (values) => values.reduce((a, b) => Math.min(a, b)), most = (values) => values.reduce((a, b) => Math.max(a, b));
    return [least(xs) - 1, least(ys) - 1, most(xs) + 1, most(ys) + 1];
  }

  function fit() {
    const [left, low, right, high] = bounds();
    camera.x = (left + right) / 2;
    camera.y = (low + high) / 2;
    camera.scale = Math.max(1, Math.min(frame.clientWidth / (right - left), frame.clientHeight / (high - low)) * 0.94);
    camera.isFitted = true;
    trailsAt = 0;
    ask();
  }

  function zoom(factor, x = frame.clientWidth / 2, y = frame.clientHeight / 2) {
    const worldX = camera.x + (x - frame.clientWidth / 2) / camera.scale, worldY = camera.y - (y - frame.clientHeight / 2) / camera.scale;
    camera.scale = Math.min(2000, Math.max(2, camera.scale * factor));
    camera.x = worldX - (x - frame.clientWidth / 2) / camera.scale;
    camera.y = worldY + (y - frame.clientHeight / 2) / camera.scale;
    moved();
  }

  function moved() {
    camera.isFitted = false;
    trailsAt = 0;
    ask();
  }

  // Pictures.
  function ask() {
    if (isDue) return;
    isDue = true;
    requestAnimationFrame(() => {
      isDue = false;
      draw();
    });
  }

  function draw() {
    const width = frame.clientWidth, height = frame.clientHeight;
    const context = fitCanvas(canvas, width, height);
    context.fillStyle = colour("--ground");
    context.fillRect(0, 0, width, height);
    const arena = store.hello?.arena;
    if (arena) {
      context.fillStyle = colour("--floor");
      context.fillRect(...corner(arena), arena.size_m[0] * camera.scale, arena.size_m[1] * camera.scale);
    }
    drawGrid(context, width, height);
    if (arena) drawArena(context, arena);
    if (options.trails) drawTrails(context, width, height);
    const names = options.names && store.names().length <= MOST_NAMES ? store.names() : [];
    const ink = colour("--ink"), ground = colour("--floor");
    store.names().forEach((name, index) => drawRobot(context, name, index, ink, ground));
    context.font = "600 12px system-ui, sans-serif";
    context.textAlign = "center";
    context.lineWidth = 3;
    context.strokeStyle = ground;
    context.fillStyle = ink;
    for (const name of names) {
      const pose = store.poses[name];
      if (!pose) continue;
      const [x, y] = toScreen(...pose.at);
      const label = `${name}${mark(name)}`;
      context.strokeText(label, x, y - ROBOT_PX - 6);
      context.fillText(label, x, y - ROBOT_PX - 6);
    }
  }

  const mark = (name) => {
    const [shape, word] = stateOf(store.robots[name]);
    return word === "ready" ? "" : ` ${shape} ${word}`;
  };

  function drawGrid(context, width, height) {
    const step = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20].find((size) => size * camera.scale > 34) ?? 50;
    context.strokeStyle = colour("--grid");
    context.lineWidth = 1;
    context.beginPath();
    const left = camera.x - width / 2 / camera.scale, low = camera.y - height / 2 / camera.scale;
    for (let x = Math.ceil(left / step) * step; x < left + width / camera.scale; x += step) line(context, toScreen(x, low), [toScreen(x, low)[0], 0]);
    for (let y = Math.ceil(low / step) * step; y < low + height / camera.scale; y += step) line(context, toScreen(left, y), [width, toScreen(left, y)[1]]);
    context.stroke();
    setText(extent, `grid ${step} m${store.hello?.arena ? ` · ${store.hello.arena.name}` : " · extent from the poses"}`);
  }

  function line(context, [x0, y0], [x1, y1]) {
    context.moveTo(Math.round(x0) + 0.5, Math.round(y0) + 0.5);
    context.lineTo(Math.round(x1) + 0.5, Math.round(y1) + 0.5);
  }

  function drawArena(context, arena) {
    for (const shape of arena.shapes) drawShape(context, shape);
    const [left, top] = corner(arena);
    context.strokeStyle = colour("--wall");
    context.lineWidth = 3;
    context.strokeRect(left, top, arena.size_m[0] * camera.scale, arena.size_m[1] * camera.scale);
    context.lineWidth = 5;
    context.strokeStyle = "#8c7bb8";
    context.beginPath();
    for (const [x0, y0, x1, y1] of arena.posters) {
      context.moveTo(...toScreen(x0, y0));
      context.lineTo(...toScreen(x1, y1));
    }
    context.stroke();
    for (const beacon of arena.beacons) {
      context.beginPath();
      context.arc(...toScreen(beacon.x_m, beacon.y_m), 6, 0, 2 * Math.PI);
      context.fillStyle = `rgb(${beacon.colour.join(" ")})`;
      context.strokeStyle = colour("--ink");
      context.lineWidth = 1;
      context.fill();
      context.stroke();
    }
  }

  function drawShape(context, shape) {
    context.save();
    context.translate(...toScreen(shape.x_m, shape.y_m));
    context.beginPath();
    if (shape.radius_m) context.arc(0, 0, shape.radius_m * camera.scale, 0, 2 * Math.PI);
    else {
      context.rotate((-shape.yaw_deg * Math.PI) / 180);
      const [along, across] = shape.size_m.map((size) => size * camera.scale);
      context.rect(-along / 2, -across / 2, along, across);
    }
    context.fillStyle = shape.kind === "drop" ? colour("--bad-soft") : colour("--obstacle");
    context.strokeStyle = shape.kind === "drop" ? colour("--bad") : colour("--wall");
    context.lineWidth = 1;
    context.setLineDash(shape.kind === "obstacle" ? [] : [4, 3]);
    context.fill();
    context.stroke();
    context.restore();
  }

  // Trails lie on a sheet of their own, which is drawn anew only now and then: a hundred robots have many points. What
  // came since then is drawn each time.
  function drawTrails(context, width, height) {
    const now = performance.now();
    if (now - trailsAt > REDRAW_TRAILS_MS || trails.dataset.size !== `${canvas.width} ${canvas.height}`) {
      const sheet = fitCanvas(trails, width, height);
      sheet.clearRect(0, 0, width, height);
      store.names().forEach((name, index) => {
        const points = store.trails[name] ?? [];
        drawTrail(sheet, points, index);
        sheetEnds[name] = points.at(-1);
      });
      trails.dataset.size = `${canvas.width} ${canvas.height}`;
      trailsAt = now;
    }
    context.drawImage(trails, 0, 0, width, height);
    store.names().forEach((name, index) => {
      const points = store.trails[name], at = store.poses[name]?.at;
      if (points && at) drawTrail(context, [...points.slice(Math.max(points.lastIndexOf(sheetEnds[name]), 0)), at], index);
    });
  }

  function drawTrail(context, points, index) {
    if (points.length < 2) return;
    context.lineWidth = 1.6;
    context.lineJoin = "round";
    context.strokeStyle = `hsl(${HUES[index % HUES.length]} 60% 50% / .55)`;
    context.beginPath();
    context.moveTo(...toScreen(...points[0]));
    for (const point of points.slice(1)) context.lineTo(...toScreen(...point));
    context.stroke();
  }

  function drawRobot(context, name, index, ink, ground) {
    const pose = store.poses[name];
    if (!pose) return;
    const [x, y] = toScreen(pose.at[0], pose.at[1]);
    const robot = store.robots[name], isWell = robot?.state === "ready" && !robot.stopped;
    const size = Math.max(6, Math.min(ROBOT_PX, camera.scale * 0.35));
    context.save();
    context.translate(x, y);
    context.rotate(-pose.at[2]);
    context.beginPath();
    context.moveTo(size * 1.25, 0);
    context.lineTo(-size, size * 0.85);
    context.lineTo(-size * 0.5, 0);
    context.lineTo(-size, -size * 0.85);
    context.closePath();
    context.fillStyle = isWell ? `hsl(${HUES[index % HUES.length]} 62% 46%)` : ground;
    context.strokeStyle = isWell ? ground : colour("--bad");
    context.lineWidth = isWell ? 1.2 : 2.2;
    context.fill();
    context.stroke();
    context.restore();
  }

  // Hands.
  const fingers = new Map();
  let pinch = 0;
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.offsetX, y: event.offsetY, moved: 0 });
    pinch = 0;
  };
  canvas.onpointermove = (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const dx = event.offsetX - finger.x, dy = event.offsetY - finger.y;
    Object.assign(finger, { x: event.offsetX, y: event.offsetY, moved: finger.moved + Math.abs(dx) + Math.abs(dy) });
    if (fingers.size === 2) {
      const [a, b] = [...fingers.values()];
      const apart = Math.hypot(a.x - b.x, a.y - b.y);
      if (pinch) zoom(apart / pinch, (a.x + b.x) / 2, (a.y + b.y) / 2);
      pinch = apart;
      return;
    }
    camera.x -= dx / camera.scale;
    camera.y += dy / camera.scale;
    moved();
  };
  canvas.onpointerup = canvas.onpointercancel = (event) => {
    const finger = fingers.get(event.pointerId);
    fingers.delete(event.pointerId);
    if (!finger || finger.moved > 6 || event.type !== "pointerup") return;
    const hit = store.names().find((name) => {
      const pose = store.poses[name];
      if (!pose) return false;
      const [x, y] = toScreen(...pose.at);
      return Math.hypot(x - finger.x, y - finger.y) < 18;
    });
    if (hit) location.hash = `#/robot/${encodeURIComponent(hit)}`;
  };
  canvas.onwheel = (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY);
  };
  canvas.onkeydown = (event) => {
    const action = { "+": () => zoom(1.3), "-": () => zoom(1 / 1.3), 0: fit }[event.key];
    if (action) action();
  };

  const observer = new ResizeObserver(() => (camera.isFitted ? fit() : ask()));
  observer.observe(frame);
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  scheme.addEventListener("change", ask);
  let isFirst = true;

  return {
    update(changed) {
      if (changed.has("hello") || (isFirst && Object.keys(store.poses).length) || (!store.hello?.arena && camera.isFitted)) {
        isFirst = !Object.keys(store.poses).length;
        fit();
      }
      const known = Object.keys(store.poses).length;
      canvas.setAttribute("aria-label", `Map of ${known} robots. The fleet view tells the same in words.`);
      if (changed.has("poses") || changed.has("robots")) draw();
    },
    leave() {
      observer.disconnect();
      scheme.removeEventListener("change", ask);
    },
  };
}
