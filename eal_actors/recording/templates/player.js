// The player of a report: moves the robots on the map, and a cursor over steps and values. Data: #player-data.
"use strict";

const byId = (id) => document.getElementById(id);
const data = JSON.parse(byId("player-data").textContent);
const slider = byId("player-time");
const button = byId("player-play");
const speed = byId("player-speed");
const clock = byId("player-clock");
const cursor = byId("player-cursor");
const lines = byId("player-lines");
const SVG = "http://www.w3.org/2000/svg";
const span_s = data.duration_s || 1;
const TRAIL_S = 10;

/** Return a new element with attributes and children. */
function element(name, attributes, ...children) {
  const made = name.startsWith("svg:") ? document.createElementNS(SVG, name.slice(4)) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** Set a text only if it changed: a page that does not change is not painted. */
function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Return the index of the last sample at or before a time, or 0. */
function indexAt(times, time) {
  let low = 0;
  let high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Return the pose at a time, between two samples on the straight line. */
function poseAt(path, time) {
  const index = indexAt(path.t, time);
  const next = Math.min(index + 1, path.t.length - 1);
  const between = path.t[next] - path.t[index];
  const share = between > 0 ? Math.min(1, Math.max(0, (time - path.t[index]) / between)) : 0;
  const turn = Math.atan2(Math.sin(path.yaw[next] - path.yaw[index]), Math.cos(path.yaw[next] - path.yaw[index]));
  return {
    index,
    x: path.x[index] + share * (path.x[next] - path.x[index]),
    y: path.y[index] + share * (path.y[next] - path.y[index]),
    yaw: path.yaw[index] + share * turn,
  };
}

/** Lay a drawing of the robots over the map, so that the map itself is painted once. */
function drawMarkers() {
  const picture = document.querySelector("#map svg");
  if (!picture || !data.map) return [];
  const overlay = element("svg:svg", { id: "player-robots", viewBox: picture.getAttribute("viewBox") });
  picture.after(overlay);
  const scale = data.map[2];
  return Object.entries(data.robots).map(([name, path]) => {
    const radius = Math.max(3, path.radius_m * scale);
    const trail = element("svg:polyline", { class: "trail", stroke: path.colour });
    const hull = element("svg:circle", { r: radius, stroke: path.colour });
    const heading = element("svg:line", { x2: radius });
    const label = element("svg:text", { x: radius + 2, y: -radius }, name);
    const marker = element("svg:g", { "data-robot": name }, hull, heading, label);
    overlay.append(trail, marker);
    return { path, trail, marker, heading };
  });
}

/** Show the robots, and the last seconds of their ways, at a time. */
function showMarkers(time) {
  for (const { path, trail, marker, heading } of markers) {
    const [zeroX, zeroY, scaleX, scaleY] = data.map;
    const pose = poseAt(path, time);
    const [x, y] = [zeroX + pose.x * scaleX, zeroY - pose.y * scaleY];
    const points = [];
    for (let index = pose.index; index >= 0 && path.t[index] >= time - TRAIL_S; index -= 1) {
      points.push(`${(zeroX + path.x[index] * scaleX).toFixed(1)},${(zeroY - path.y[index] * scaleY).toFixed(1)}`);
    }
    trail.setAttribute("points", `${x.toFixed(1)},${y.toFixed(1)} ${points.join(" ")}`);
    marker.setAttribute("transform", `translate(${x} ${y})`);
    heading.setAttribute("transform", `rotate(${(-pose.yaw * 180) / Math.PI})`);
  }
}

/** Add a row with a robot's steps at the shown time; its colour is that of its path. */
function addRobot([name, steps]) {
  const state = element("span", {});
  const dot = element("i", { style: `background:${data.robots[name]?.colour ?? "none"}` });
  byId("player-now").append(element("li", {}, dot, element("b", {}, name), state));
  return { steps, state };
}

function showSteps(time) {
  for (const { steps, state } of robots) {
    const running = steps.filter((step) => step.start_s <= time && time <= step.end_s);
    const texts = running.map(({ label, outcome }) => (outcome === "done" ? label : `${label} (${outcome})`));
    setText(state, texts.join(", ") || "–");
  }
}

const number = (value, unit) => `${Number(value.toPrecision(4))} ${unit}`.trim();

/** Draw the values of a topic over the time of the run, below the steps. */
function drawPlot([topic, { unit, t, v }]) {
  const least = v.reduce((a, b) => Math.min(a, b));
  const greatest = v.reduce((a, b) => Math.max(a, b));
  const height = (value) => (greatest === least ? 0.5 : (greatest - value) / (greatest - least)) * 90 + 5;
  const points = t.map((at, index) => `${((at / span_s) * 1000).toFixed(1)},${height(v[index]).toFixed(1)}`);
  const chart = element("svg:svg", { viewBox: "0 0 1000 100", preserveAspectRatio: "none" });
  chart.append(element("svg:polyline", { points: points.join(" ") }));
  const value = element("output", {});
  const range = element("small", {}, `${number(least, "")} to ${number(greatest, unit)}`);
  const name = element("span", { class: "name" }, topic.slice(1), element("br", {}), value, range);
  lines.append(element("div", { class: "row plot" }, name, element("div", { class: "lane" }, chart)));
  return { t, v, unit, value };
}

function showValues(time) {
  for (const { t, v, unit, value } of plots) {
    setText(value, t[0] <= time ? number(v[indexAt(t, time)], unit) : "–");
  }
}

function addCamera([topic, frames]) {
  const image = element("img", { alt: topic });
  byId("player-cameras").append(element("figure", {}, image, element("figcaption", {}, topic.slice(1))));
  return { times: frames.map(([at]) => at), frames, image, shown: -1 };
}

function showFrames(time) {
  for (const camera of cameras) {
    const index = indexAt(camera.times, time);
    if (index !== camera.shown) camera.image.src = camera.frames[index][1];
    camera.shown = index;
  }
}

const markers = drawMarkers();
const robots = Object.entries(data.steps).map(addRobot);
const plots = Object.entries(data.plots).map(drawPlot);
const cameras = Object.entries(data.cameras).map(addCamera);
let now = 0;

/** Show the run at a time, in seconds since its start. */
function show(wanted) {
  now = Math.min(data.duration_s, Math.max(0, wanted));
  slider.value = now;
  slider.setAttribute("aria-valuetext", `${now.toFixed(2)} of ${data.duration_s.toFixed(2)} s`);
  setText(clock, `${now.toFixed(2)} s`);
  cursor.style.transform = `translateX(${(now / span_s) * 100}cqw)`; // a layer of its own, which is not painted again
  showMarkers(now);
  showSteps(now);
  showValues(now);
  showFrames(now);
}

let before = null;

function advance(stamp) {
  if (before === null) return;
  show(now + (Math.max(0, stamp - before) / 1000) * Number(speed.value));
  before = stamp;
  if (now >= data.duration_s) play(false);
  else requestAnimationFrame(advance);
}

/** Start or stop. */
function play(starts) {
  setText(button, starts ? "Pause" : "Play");
  if (starts && before === null) {
    if (now >= data.duration_s) show(0);
    before = performance.now();
    requestAnimationFrame(advance);
  } else if (!starts) {
    before = null;
  }
}

/** Show the time at which the pointer is on the lines. */
function seek(event) {
  const frame = cursor.parentElement.getBoundingClientRect();
  show(((event.clientX - frame.left) / frame.width) * data.duration_s);
}

slider.addEventListener("input", () => show(Number(slider.value)));
button.addEventListener("click", () => play(before === null));
lines.addEventListener("pointerdown", (event) => {
  if (event.button !== 0) return;
  lines.setPointerCapture(event.pointerId);
  seek(event);
});
lines.addEventListener("pointermove", (event) => lines.hasPointerCapture(event.pointerId) && seek(event));
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !event.repeat && window.parent !== window) {
    window.parent.postMessage("Escape", "*"); // a dashboard around this page stops the robots
    return;
  }
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select")) return;
  if (event.key === " " && event.target.closest("button, summary, a")) return; // it activates them
  const step = event.shiftKey ? 0.1 : 1;
  const actions = {
    " ": () => play(before === null),
    ArrowLeft: () => show(now - step),
    ArrowRight: () => show(now + step),
    Home: () => show(0),
    End: () => show(data.duration_s),
  };
  if (actions[event.key]) {
    actions[event.key]();
    event.preventDefault();
  }
});
show(0);
