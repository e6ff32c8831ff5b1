// Which cameras the page watches: parts of a view name theirs, the server gets the union of all.

import { send } from "./connection.js";
import { store } from "./store.js";

/** @import { FrameHeader } from "./types" */
/** @typedef {(header: FrameHeader, jpeg: Blob | null) => void} ShowFrame */
/** @typedef {{ cameras: [string, string][], rate_hz: number, show: ShowFrame }} Watcher */

const MAX_CAMERAS = 4;
/** @type {Map<object, Watcher>} */
const watchers = new Map();

/** Return how many cameras a page may watch at once. */
export function mostCameras() {
  return store.hello?.max_cameras ?? MAX_CAMERAS;
}

/**
 * Watch cameras in place of those that this part watched before. Call it again after each new connection.
 *
 * @param {object} part
 * @param {[string, string][]} cameras - robots and their resources.
 * @param {number} rate_hz
 * @param {ShowFrame} show - called with each frame of these cameras.
 */
export function watch(part, cameras, rate_hz, show) {
  if (cameras.length) watchers.set(part, { cameras, rate_hz, show });
  else watchers.delete(part);
  const all = [...watchers.values()];
  const keys = new Map(all.flatMap((watcher) => watcher.cameras).map((camera) => [camera.join("/"), camera]));
  send({
    do: "watch",
    cameras: [...keys.values()].slice(0, mostCameras()),
    rate_hz: Math.max(1, ...all.map((watcher) => watcher.rate_hz)),
  });
}

/** @type {ShowFrame} */
export function showFrame(header, jpeg) {
  for (const { cameras, show } of watchers.values()) {
    if (cameras.some(([robot, resource]) => robot === header.robot && resource === header.resource)) show(header, jpeg);
  }
}
