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
  hull.setAttribute("r", Math.max(3, data.radius_m * scaleX));
  hull.setAttribute("style", "fill: #ffffffaa; stroke: #000000; stroke-width: 1.2");
  const heading = document.createElementNS(SVG, "line");
  heading.setAttribute("x2", Math.max(3, data.radius_m * scaleX));
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
  const running = data.steps.filter((step) => step.start_s <= time && time <= step.end_s);
  const text = running.map((step) => `${step.robot}: ${step.label}${step.outcome === "done" ? "" : ` (${step.outcome})`}`);
  if (text.join("\n") !== shownSteps) {
    shownSteps = text.join("\n");
    now.replaceChildren(...text.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
  }
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
document.getElementById("player-chart").addEventListener("click", (event) => {
  const chart = event.currentTarget;
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(chart.getScreenCTM().inverse());
  show(((point.x - data.chart[0]) / data.chart[1]) * data.duration_s);
});
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
