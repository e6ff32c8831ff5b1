// The picture of the floor beneath the map: a tracker's resource `Floor`, as large as the world.

import { watch } from "./frames.js";
import { store } from "./store.js";

/** @import { FrameHeader } from "./types" */

const RESOURCE = "Floor";
const RATE_HZ = 1;

export class FloorPicture {
  /** @type {ImageBitmap | null} */
  image = null;
  frames = 0;
  watched = "";

  /** @param {() => void} onChange */
  constructor(onChange) {
    this.onChange = onChange;
  }

  /** Watch the first camera of the floor, or none. @param {boolean} isWanted */
  watch(isWanted) {
    const robot = store.names().find((name) => store.robots[name]?.cameras?.includes(RESOURCE));
    const watched = isWanted && store.hello?.world && robot ? robot : "";
    if (watched === this.watched) return;
    this.watched = watched;
    watch(this, watched ? [[watched, RESOURCE]] : [], RATE_HZ, (header, jpeg) => this.show(header, jpeg));
    if (!watched) this.image = null;
    this.onChange();
  }

  /** @param {FrameHeader} header @param {Blob | null} jpeg */
  async show(header, jpeg) {
    if (!jpeg || header.robot !== this.watched || header.resource !== RESOURCE) return;
    const image = await createImageBitmap(jpeg);
    this.image?.close();
    this.image = image;
    this.frames += 1;
    this.onChange();
  }
}
