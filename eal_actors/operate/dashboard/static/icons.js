// The page's icons. Those of views and tools are lines; those of states are filled, so that no two have one outline.

const SVG = "http://www.w3.org/2000/svg";
/** @type {Record<string, string>} Paths in a square of 24 units. */
const LINES = {
  mission: "M12 2.5v4M12 17.5v4M2.5 12h4M17.5 12h4M12 18.5a6.5 6.5 0 1 0 0-13 6.5 6.5 0 0 0 0 13ZM12 12h.01",
  fleet:
    "M5 10h14v8H5zM8.5 18v2.5M15.5 18v2.5M12 10V6.5M12 6.5a1.5 1.5 0 1 0 0-3 1.5 1.5 0 0 0 0 3ZM9 14h.01M15 14h.01",
  map: "M9 4 3.5 6.5v13.5L9 17.5l6 2.5 5.5-2.5V4L15 6.5ZM9 4v13.5M15 6.5V20",
  cameras: "M3.5 7.5h11v10h-11zM14.5 11.2l6-3.2v9l-6-3.2",
  scenario: "M5 4.5h6v5H5zM13 14.5h6v5h-6zM8 9.5v4a3 3 0 0 0 3 3h2M15 7h4.5M17.2 4.7 19.5 7l-2.3 2.3",
  logs: "M5 3.5h14v17H5zM8.5 8h7M8.5 12h7M8.5 16h4",
  trails: "M5 19c8 0 0-9 7-9 5 0 3-5 7-5M5 19h.01M19 5h.01",
  names: "M4 6.5h12l4 5.5-4 5.5H4zM8 12h6",
  views: "M4 12 20 5v14ZM4 12h.01",
  picture: "M4 5h16v14H4zM4 16l5-5 4 4 3-3 4 4M15.5 9h.01",
  less: "M6 12h12",
  more: "M12 6v12M6 12h12",
  fit: "M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5",
  zone: "M5 6.5 13 4l6 6-3 9-10-1ZM9 9l6 6",
};
/** @type {Record<string, string>} By the sign that stands for the same state where there is only text. */
const STATES = {
  "●": "M12 21.5a9.5 9.5 0 1 0 0-19 9.5 9.5 0 0 0 0 19Z",
  "○": "M12 20.5a8.5 8.5 0 1 0 0-17 8.5 8.5 0 0 0 0 17Zm0-4a4.5 4.5 0 1 1 0-9 4.5 4.5 0 0 1 0 9Z",
  "◌": "M10.4 3h3.2v5h-3.2zM10.4 16h3.2v5h-3.2zM3 10.4h5v3.2H3zM16 10.4h5v3.2h-5z",
  "◐": "M12 20.5a8.5 8.5 0 1 0 0-17 8.5 8.5 0 0 0 0 17Zm0-3v-11a5.5 5.5 0 0 1 0 11Z",
  "▲": "M12 3.5 22 20.5H2Z",
  "▽": "M12 20.5 2 3.5h20Zm0-7.9L15 7.5H9Z",
  "■": "M4.5 4.5h15v15h-15z",
  "✕": "M6.2 3.4 12 9.2l5.8-5.8 2.8 2.8L14.8 12l5.8 5.8-2.8 2.8L12 14.8l-5.8 5.8-2.8-2.8L9.2 12 3.4 6.2Z",
};

/** @param {string} path @param {string} kind */
function drawing(path, kind) {
  const node = document.createElementNS(SVG, "svg");
  for (const [name, value] of Object.entries({ class: kind, viewBox: "0 0 24 24", "aria-hidden": "true" }))
    node.setAttribute(name, value);
  const line = document.createElementNS(SVG, "path");
  line.setAttribute("d", path);
  node.append(line);
  return node;
}

/** @param {string} name */
export function icon(name) {
  return drawing(LINES[name], "icon");
}

/** Return the icon of a state. @param {string} sign - as in `stateOf`. */
export function stateIcon(sign) {
  return drawing(STATES[sign] ?? STATES["◌"], "state-icon");
}
