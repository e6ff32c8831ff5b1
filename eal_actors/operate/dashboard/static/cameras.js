// Up to four cameras: the newest frame of each, how old it is, and whether it still changes.

import { el, seconds, setText } from "./dom.js";
import { say } from "./link.js";
import { store } from "./store.js";

const FROZEN_S = 2, SAME_S = 3;
const RATES = [1, 2, 5, 10, 15];
let shown = null;
let chosen = null, rate = 5;

export function takeFrame(header, picture) {
  shown?.get(`${header.robot}/${header.resource}`)?.take(header, picture);
}

export function camerasView(root) {
  const list = el("div", { class: "row choices" });
  const tiles = el("div", { class: "cameras" });
  const none = el("p", { class: "faint" }, "Choose a camera.");
  const select = el("select", { "aria-label": "Frames a second", onchange: () => {
    rate = Number(select.value);
    watch();
  } }, ...RATES.map((value) => el("option", { value, selected: value === rate }, `${value} a second`)));
  root.append(el("div", { class: "row" }, el("h1", { class: "grow" }, "Cameras"), el("label", {}, "Frames", select)),
    el("div", { class: "panel stack" }, el("span", { class: "small faint" }, "At most four at once"), list), none, tiles);
  shown = new Map();
  let known = "";

  function watch() {
    say({ do: "watch", cameras: [...shown.values()].map((tile) => [tile.robot, tile.resource]), rate_hz: rate });
    none.hidden = shown.size > 0;
  }

  function choose(key, isOn) {
    isOn ? chosen.add(key) : chosen.delete(key);
    arrange();
  }

  function arrange() {
    for (const [key, tile] of shown) if (!chosen.has(key)) {
      tile.node.remove();
      shown.delete(key);
    }
    for (const key of chosen) if (!shown.has(key)) {
      const slash = key.indexOf("/");
      const tile = new Tile(key.slice(0, slash), key.slice(slash + 1));
      shown.set(key, tile);
      tiles.append(tile.node);
    }
    for (const box of list.querySelectorAll("input")) box.disabled = !box.checked && chosen.size >= (store.hello?.max_cameras ?? 4);
    watch();
  }

  function update(changed) {
    const keys = store.names().flatMap((robot) => (store.robots[robot]?.cameras ?? []).map((camera) => `${robot}/${camera}`));
    if (keys.join() !== known) {
      known = keys.join();
      chosen = chosen ? new Set([...chosen].filter((key) => keys.includes(key))) : new Set(keys.slice(0, keys.length > 4 ? 1 : 4));
      list.replaceChildren(...(keys.length ? keys.map((key) => el("label", {},
        el("input", { type: "checkbox", checked: chosen.has(key), onchange: (event) => choose(key, event.target.checked) }), key))
        : [el("span", { class: "faint" }, "No robot has a camera.")]));
      arrange();
    } else if (changed.has("hello")) watch();
  }
  const timer = setInterval(() => shown?.forEach((tile) => tile.age()), 200);
  return {
    update,
    leave() {
      clearInterval(timer);
      shown = null;
      say({ do: "watch", cameras: [] });
    },
  };
}

class Tile {
  constructor(robot, resource) {
    Object.assign(this, { robot, resource, header: null, isDrawing: false });
    this.canvas = el("canvas", { role: "img", "aria-label": `Camera ${robot}/${resource}` });
    this.mark = el("div", { class: "mark", role: "status", hidden: true });
    this.text = el("span", { class: "number" }, "waiting for a frame");
    this.same = el("span", { class: "chip", hidden: true });
    this.node = el("figure", { class: "panel camera" },
      el("div", { class: "picture" }, this.canvas, this.mark),
      el("figcaption", { class: "caption" }, el("strong", {}, `${robot}/${resource}`), this.same, this.text));
    this.node.style.margin = "0";
    this.node.dataset.camera = `${robot}/${resource}`;
  }

  async take(header, picture) {
    this.header = header;
    this.age();
    if (!picture || this.isDrawing) return;
    this.isDrawing = true;
    try {
      const image = await createImageBitmap(picture);
      this.canvas.width = image.width;
      this.canvas.height = image.height;
      this.canvas.getContext("2d").drawImage(image, 0, 0);
      image.close();
      this.node.dataset.frames = String(Number(this.node.dataset.frames ?? 0) + 1);
    } finally {
      this.isDrawing = false;
    }
  }

  age() {
    const header = this.header;
    if (!header) return;
    const realRate = store.hello?.rate ?? 1;
    const age = header.stamp_s === null ? null : Math.max(0, store.fleetNow() - header.stamp_s) / realRate;
    const isFrozen = age !== null && age > Math.max(FROZEN_S, 3 / rate);
    const same = header.same_since_s === null ? 0 : (header.stamp_s - header.same_since_s) / realRate;
    setText(this.text, age === null ? "no frame yet" : `${seconds(age)} old`);
    this.same.hidden = isFrozen || same < SAME_S;
    setText(this.same, `unchanged for ${seconds(same)}`);
    this.node.classList.toggle("frozen", isFrozen);
    this.mark.hidden = !isFrozen && !header.error;
    setText(this.mark, isFrozen ? `✕ FROZEN: no new frame for ${seconds(age)}${header.error ? `. ${header.error}` : ""}` : header.error ? `▲ ${header.error}` : "");
  }
}
