// The player of a report: moves the robots on the map, and a cursor on the time line. Data: the element #player-data.
"use strict";

const data = JSON.parse(document.getElementById("player-data").textContent);
const slider = document.getElementById("player-time");
const button = document.getElementById("player-play");
const speed = document.getElementById("player-speed");
const clock = document.getElementById("player-clock");
const now = document.getElementById("player-now");
const cursor = document.getElementById("player-cursor");
const picture = document.querySelector("#map svg");
const SVG = "http://www.w3.org/2000/svg";
const [zeroX, zeroY, scaleX, scaleY] = data.map;

const markers = Object.entries(data.robots).map(([name, path]) => {
  const marker = document.createElementNS(SVG, "g");
  const hull = document.createElementNS(SVG, "circle");
  const radius = Math.max(3, (data.radii_m[name] ?? data.radius_m) * scaleX);
  hull.setAttribute("r", radius);
  hull.setAttribute("style", "fill: #ffffffaa; stroke: #000000; stroke-width: 1.2");
  const heading = document.createElementNS(SVG, "line");
  heading.setAttribute("x2", radius);
  heading.setAttribute("style", "stroke: #000000; stroke-width: 2");
  const label = document.createElementNS(SVG, "title");
  label.textContent = name;
  marker.append(hull, heading, label);
  picture?.append(marker);
  return { name, path, marker, heading };
});

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
  const span = path.t[next] - path.t[index];
  const share = span > 0 ? Math.min(1, Math.max(0, (time - path.t[index]) / span)) : 0;
  const turn = Math.atan2(Math.sin(path.yaw[next] - path.yaw[index]), Math.cos(path.yaw[next] - path.yaw[index]));
  return {
    x: path.x[index] + share * (path.x[next] - path.x[index]),
    y: path.y[index] + share * (path.y[next] - path.y[index]),
    yaw: path.yaw[index] + share * turn,
  };
}

const PLOT_HEIGHT = 60;

/** Draw the values of a topic over the time of the run, on the axis of the time line. */
function drawPlot([topic, plot]) {
  const least = plot.v.reduce((a, b) => Math.min(a, b));
  const greatest = plot.v.reduce((a, b) => Math.max(a, b));
  const x = (at) => data.chart[0] + (at / (data.duration_s || 1)) * data.chart[1];
  const y = (value) => PLOT_HEIGHT - 6 - ((value - least) / (greatest - least || 1)) * (PLOT_HEIGHT - 12);
  const chart = document.createElementNS(SVG, "svg");
  chart.setAttribute("viewBox", `0 0 ${data.chart[0] + data.chart[1] + 30} ${PLOT_HEIGHT}`);
  chart.setAttribute("width", data.chart[0] + data.chart[1] + 30);
  chart.setAttribute("class", "plot");
  const line = document.createElementNS(SVG, "polyline");
  line.setAttribute("points", plot.t.map((at, index) => `${x(at).toFixed(1)},${y(plot.v[index]).toFixed(1)}`).join(" "));
  const texts = [topic, `${greatest.toPrecision(4)} ${plot.unit}`, `${least.toPrecision(4)} ${plot.unit}`];
  const labels = texts.map((text, index) => {
    const label = document.createElementNS(SVG, "text");
    label.setAttribute("y", [14, 30, PLOT_HEIGHT - 8][index]);
    label.textContent = text;
    return label;
  });
  const mark = document.createElementNS(SVG, "line");
  mark.setAttribute("y2", PLOT_HEIGHT);
  const value = document.createElementNS(SVG, "text");
  value.setAttribute("y", 12);
  chart.append(line, ...labels, mark, value);
  chart.addEventListener("click", seek);
  document.getElementById("player-plots").append(chart);
  return { plot, mark, value };
}

const plots = Object.entries(data.plots).map(drawPlot);

const cameras = Object.entries(data.cameras).map(([topic, frames]) => {
  const figure = document.createElement("figure");
  const image = Object.assign(document.createElement("img"), { alt: topic });
  figure.append(image, Object.assign(document.createElement("figcaption"), { textContent: topic }));
  document.getElementById("player-cameras").append(figure);
  return { times: frames.map(([at]) => at), frames, image, shown: -1 };
});

/** Show the values and the camera frames of a time. */
function showMedia(at, x) {
  for (const { plot, mark, value } of plots) {
    mark.setAttribute("x1", x);
    mark.setAttribute("x2", x);
    value.setAttribute("x", Math.min(x + 4, data.chart[0] + data.chart[1] - 60));
    const isKnown = plot.t[0] <= at;
    value.textContent = isKnown ? `${plot.v[indexAt(plot.t, at)].toPrecision(4)} ${plot.unit}` : "";
  }
  for (const camera of cameras) {
    const index = indexAt(camera.times, at);
    if (index !== camera.shown) camera.image.src = camera.frames[index][1];
    camera.shown = index;
  }
}

let time = 0;
let shownSteps = "";

/** Show the run at a time, in seconds since its start. */
function show(wanted) {
  time = Math.min(data.duration_s, Math.max(0, wanted));
  slider.value = time;
  clock.textContent = `${time.toFixed(2)} s`;
  for (const { path, marker, heading } of markers) {
    const pose = poseAt(path, time);
    marker.setAttribute("transform", `translate(${zeroX + pose.x * scaleX} ${zeroY - pose.y * scaleY})`);
    heading.setAttribute("transform", `rotate(${(-pose.yaw * 180) / Math.PI})`);
  }
  const x = data.chart[0] + (time / (data.duration_s || 1)) * data.chart[1];
  cursor.setAttribute("x1", x);
  cursor.setAttribute("x2", x);
  showMedia(time, x);
  const running = data.steps.filter((step) => step.start_s <= time && time <= step.end_s);
  const text = running.map((step) => `${step.robot}: ${step.label}${step.outcome === "done" ? "" : ` (${step.outcome})`}`);
  if (text.join("\n") !== shownSteps) {
    shownSteps = text.join("\n");
    now.replaceChildren(...text.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
  }
}

/** Show the time at which somebody clicks on the time line or a plot. */
function seek(event) {
  const chart = event.currentTarget;
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(chart.getScreenCTM().inverse());
  show(((point.x - data.chart[0]) / data.chart[1]) * data.duration_s);
}

let before = null;

function advance(stamp) {
  if (before === null) return;
  show(time + ((stamp - before) / 1000) * Number(speed.value));
  before = stamp;
  if (time >= data.duration_s) play(false);
  else requestAnimationFrame(advance);
}

/** Start or stop. */
function play(starts) {
  button.textContent = starts ? "pause" : "play";
  if (starts && before === null) {
    if (time >= data.duration_s) show(0);
    before = performance.now();
    requestAnimationFrame(advance);
  } else if (!starts) {
    before = null;
  }
}

slider.addEventListener("input", () => show(Number(slider.value)));
button.addEventListener("click", () => play(before === null));
document.getElementById("player-chart").addEventListener("click", seek);
document.addEventListener("keydown", (event) => {
  if (event.target instanceof HTMLSelectElement || event.ctrlKey || event.metaKey || event.altKey) return;
  const step = event.shiftKey ? 0.1 : 1;
  const actions = {
    " ": () => play(before === null),
    ArrowLeft: () => show(time - step),
    ArrowRight: () => show(time + step),
    Home: () => show(0),
    End: () => show(data.duration_s),
  };
  if (actions[event.key]) {
    actions[event.key]();
    event.preventDefault();
  }
});
show(0);
