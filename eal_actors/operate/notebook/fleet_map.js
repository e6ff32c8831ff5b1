// The map of FleetMap. Names of robots are drawn as text.

const MARGIN_PX = 20;
const STOPPED = "emergency stop"; // confirmed
const COLOURS = { ready: "#1f6fb4", failed: "#c2170c", [STOPPED]: "#c2170c", "stop NOT CONFIRMED": "#c2170c" };
const SENT = "STOP sent, NOT CONFIRMED: the kernel has not answered yet. It obeys at the end of the cell that runs.";

/** Fit the world, or the robots where there is none, into the canvas; return a function from metres to pixels. */
function projection(canvas, world, poses) {
  const places = Object.values(poses);
  const reach = Math.max(1, ...places.flatMap(([x, y]) => [Math.abs(x), Math.abs(y)])) + 0.5;
  const [width_m, depth_m] = world?.size_m ?? [2 * reach, 2 * reach];
  const scale = Math.min((canvas.width - 2 * MARGIN_PX) / width_m, (canvas.height - 2 * MARGIN_PX) / depth_m);
  return { scale, width_m, depth_m, at: (x, y) => [canvas.width / 2 + x * scale, canvas.height / 2 - y * scale] };
}

function drawShape(context, view, shape) {
  const [x, y] = view.at(shape.x_m, shape.y_m);
  context.fillStyle = shape.kind === "drop" ? "#e8c9c9" : "#b5b9c0";
  context.beginPath();
  if (shape.radius_m) context.arc(x, y, shape.radius_m * view.scale, 0, 2 * Math.PI);
  else {
    const turn = (-shape.yaw_deg * Math.PI) / 180;
    const [half, side] = shape.size_m.map((size) => (size * view.scale) / 2);
    for (const [along, across] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
      const [dx, dy] = [along * half, across * side];
      context.lineTo(x + dx * Math.cos(turn) - dy * Math.sin(turn), y + dx * Math.sin(turn) + dy * Math.cos(turn));
    }
  }
  context.fill();
}

function drawRobot(context, view, name, [x_m, y_m, yaw_rad], state) {
  const [x, y] = view.at(x_m, y_m);
  const size = Math.max(6, 0.15 * view.scale);
  context.fillStyle = context.strokeStyle = COLOURS[state] ?? "#777";
  context.beginPath();
  context.arc(x, y, size, 0, 2 * Math.PI);
  context.fill();
  context.lineWidth = 3;
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(x + 1.7 * size * Math.cos(yaw_rad), y - 1.7 * size * Math.sin(yaw_rad));
  context.stroke();
  context.fillStyle = "#222";
  context.fillText(name, x + size + 3, y - size);
}

/** Return how many robots are in each state, with the names of those that are not ready. */
function textOf(states) {
  const robots = Object.groupBy(Object.keys(states), (name) => states[name]);
  const parts = Object.entries(robots).map(([state, names]) =>
    state === "ready" ? `${names.length} ready` : `${names.length} ${state} (${names.join(", ")})`,
  );
  return parts.join("; ") || "The fleet is closed: nothing is shown, and STOP stops nothing.";
}

function render({ model, el }) {
  const canvas = document.createElement("canvas");
  canvas.width = 560;
  canvas.height = 420;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "Map of the fleet");
  const stop = document.createElement("button");
  stop.textContent = "STOP all robots";
  stop.style.cssText = "display:block;background:#c2170c;color:white;font-weight:bold;padding:6px 14px;border:0";
  const line = document.createElement("p");
  line.setAttribute("role", "status");
  stop.onclick = () => {
    model.send("stop");
    if (Object.values(model.get("states")).some((state) => state !== STOPPED)) line.textContent = SENT;
  };
  const showStates = () => {
    line.textContent = textOf(model.get("states"));
    draw();
  };
  const draw = () => {
    const [world, poses, states] = [model.get("world"), model.get("poses"), model.get("states")];
    const context = canvas.getContext("2d");
    const view = projection(canvas, world, poses);
    context.fillStyle = "white";
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.font = "13px sans-serif";
    const [left, top] = view.at(-view.width_m / 2, view.depth_m / 2);
    context.strokeStyle = "#444";
    context.strokeRect(left, top, view.width_m * view.scale, view.depth_m * view.scale);
    for (const shape of world?.shapes ?? []) drawShape(context, view, shape);
    for (const [name, pose] of Object.entries(poses)) drawRobot(context, view, name, pose, states[name]);
  };
  model.on("change:poses", draw);
  model.on("change:states", showStates);
  showStates();
  el.append(canvas, stop, line);
}

export default { render };
