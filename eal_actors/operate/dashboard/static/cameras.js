// Up to four cameras: the newest frame of each, its age, and whether the picture still changes.

import { contextOf, el, formatSeconds, setText } from "./dom.js";
import { mostCameras, watch as watchCameras } from "./frames.js";
import { store } from "./store.js";

/** @import { FrameHeader, View } from "./types" */

const FROZEN_S = 2; // no new frame for this long
const UNCHANGED_S = 3; // new frames, but the same picture for this long
const RATES_HZ = [1, 2, 5, 10, 15];
/** @type {Map<string, Tile>} Tiles by `robot/resource`. */
const tiles = new Map();
/** @type {Set<string> | null} The cameras that the user chose; null before the first visit. */
let chosen = null;
let rate_hz = 5;

/** @param {HTMLElement} root @returns {View} */
export function camerasView(root) {
  const list = el("div", { class: "row choices" });
  const grid = el("div", { class: "cameras" });
  const hint = el("p", { class: "faint" }, "Choose a camera.");
  const rates = el(
    "select",
    {
      onchange: () => {
        rate_hz = Number(rates.value);
        watch();
      },
    },
    ...RATES_HZ.map((value) =>
      el("option", { value: String(value), selected: value === rate_hz }, `${value} per second`),
    ),
  );
  root.append(
    el("div", { class: "row" }, el("h1", { class: "grow" }, "Cameras"), el("label", {}, "Frames", rates)),
    el("div", { class: "panel stack" }, el("span", { class: "small faint" }, "Choose up to four cameras"), list),
    hint,
    grid,
  );
  let shownKeys = "";

  function watch() {
    const cameras = [...tiles.values()].map((tile) => tile.camera);
    watchCameras(tiles, cameras, rate_hz, (header, jpeg) =>
      tiles.get(`${header.robot}/${header.resource}`)?.show(header, jpeg),
    );
    hint.hidden = tiles.size > 0;
  }

  /** @param {Set<string>} keys */
  function showTiles(keys) {
    for (const [key, tile] of tiles) {
      if (keys.has(key)) continue;
      tile.node.remove();
      tiles.delete(key);
    }
    for (const key of keys) {
      if (tiles.has(key)) continue;
      const tile = new Tile(key);
      tiles.set(key, tile);
      grid.append(tile.node);
    }
    const isFull = keys.size >= mostCameras();
    for (const box of list.querySelectorAll("input")) box.disabled = !box.checked && isFull;
    watch();
  }

  /** @param {string} key @param {Set<string>} keys */
  function choiceOf(key, keys) {
    const box = el("input", { type: "checkbox", checked: keys.has(key) });
    box.onchange = () => {
      if (box.checked) keys.add(key);
      else keys.delete(key);
      showTiles(keys);
    };
    return el("label", {}, box, key);
  }

  /** @type {View["update"]} */
  function update(changed) {
    const keys = store
      .names()
      .flatMap((robot) => (store.robots[robot]?.cameras ?? []).map((camera) => `${robot}/${camera}`));
    if (keys.join() !== shownKeys) {
      shownKeys = keys.join();
      const current = new Set(chosen ? keys.filter((key) => chosen?.has(key)) : keys.slice(0, mostCameras()));
      chosen = current;
      list.replaceChildren(...keys.map((key) => choiceOf(key, current)));
      if (!keys.length) list.append(el("span", { class: "faint" }, "No robot has a camera."));
      showTiles(current);
    } else if (changed.has("hello")) {
      watch();
    }
  }
  const timer = setInterval(() => {
    for (const tile of tiles.values()) tile.showAge();
  }, 200);
  return {
    update,
    leave() {
      clearInterval(timer);
      tiles.clear();
      watchCameras(tiles, [], 1, () => {});
    },
  };
}

/** A camera's newest picture. */
export class Tile {
  /** @type {FrameHeader | null} */
  header = null;
  isDrawing = false;
  frames = 0;

  /** @param {string} key - `robot/resource`. @param {() => number} [rateOf] - returns the frames per second. */
  constructor(key, rateOf = () => rate_hz) {
    this.rateOf = rateOf;
    const slash = key.indexOf("/");
    /** @type {[string, string]} */
    this.camera = [key.slice(0, slash), key.slice(slash + 1)];
    this.canvas = el("canvas", { role: "img", "aria-label": `Camera ${key}` });
    this.mark = el("div", { class: "mark", role: "status", hidden: true });
    this.text = el("span", { class: "number" }, "waiting for a frame …");
    this.unchanged = el("span", { class: "chip", hidden: true });
    this.node = el(
      "figure",
      { class: "panel camera", "data-camera": key },
      el("div", { class: "picture" }, this.canvas, this.mark),
      el("figcaption", { class: "caption" }, el("strong", {}, key), this.unchanged, this.text),
    );
  }

  /** @param {FrameHeader} header @param {Blob | null} jpeg */
  async show(header, jpeg) {
    this.header = header;
    this.showAge();
    if (!jpeg || this.isDrawing) return; // a slow page skips frames
    this.isDrawing = true;
    try {
      const image = await createImageBitmap(jpeg);
      this.canvas.width = image.width;
      this.canvas.height = image.height;
      contextOf(this.canvas).drawImage(image, 0, 0);
      image.close();
      this.frames += 1;
      this.node.dataset.frames = String(this.frames);
    } finally {
      this.isDrawing = false;
    }
  }

  showAge() {
    if (!this.header) return;
    const { stamp_s, same_since_s, error } = this.header;
    const rate = store.hello?.rate ?? 1;
    const age_s = stamp_s === null ? null : Math.max(0, store.fleetNow() - stamp_s) / rate;
    const isFrozen = age_s !== null && age_s > Math.max(FROZEN_S, 3 / this.rateOf());
    const same_s = stamp_s === null || same_since_s === null ? 0 : (stamp_s - same_since_s) / rate;
    setText(this.text, age_s === null ? "no frame yet" : `${formatSeconds(age_s)} old`);
    this.unchanged.hidden = isFrozen || same_s < UNCHANGED_S;
    setText(this.unchanged, `unchanged for ${formatSeconds(same_s)}`);
    this.node.classList.toggle("frozen", isFrozen);
    this.mark.hidden = !isFrozen && !error;
    const frozen = isFrozen ? `✕ FROZEN: no new frame for ${formatSeconds(age_s)}.` : "▲";
    setText(this.mark, [frozen, error].filter(Boolean).join(" "));
  }
}
