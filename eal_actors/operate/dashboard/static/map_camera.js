// What part of the world a map shows, and how large.

/** @import { Point } from "./types" */

const MARGIN = 0.94; // of the frame, for the whole world
const SCALES = [2, 2000];

export class MapCamera {
  /** The size of the frame, in pixels: kept here, because asking the page for it lays the page out. */
  width = 0;
  height = 0;
  /** The point in the middle, in metres, and the pixels of a metre. */
  x = 0;
  y = 0;
  scale = 60;
  /** Whether it shows all there is. */
  isFitted = true;

  /** @param {number} x @param {number} y @returns {Point} - in pixels of the frame. */
  toScreen = (x, y) => [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];

  /** @param {number} x @param {number} y @returns {Point} - in metres, of a pixel of the frame. */
  toWorld(x, y) {
    return [this.x + (x - this.width / 2) / this.scale, this.y - (y - this.height / 2) / this.scale];
  }

  /** @param {number[]} bounds - left, low, right and high, in metres. */
  fit([left, low, right, high]) {
    this.x = (left + right) / 2;
    this.y = (low + high) / 2;
    this.scale = Math.max(1, Math.min(this.width / (right - left), this.height / (high - low)) * MARGIN);
    this.isFitted = true;
  }

  /**
   * Zoom around a pixel, which is the middle unless given.
   *
   * @param {number} factor
   * @param {number} [x]
   * @param {number} [y]
   */
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const [fixed_x, fixed_y] = this.toWorld(x, y);
    this.scale = Math.min(SCALES[1], Math.max(SCALES[0], this.scale * factor));
    const [moved_x, moved_y] = this.toWorld(x, y);
    this.x += fixed_x - moved_x;
    this.y += fixed_y - moved_y;
    this.isFitted = false;
  }

  /** @param {number} dx @param {number} dy - in pixels. */
  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.isFitted = false;
  }

  /** Return a text that differs if something is drawn elsewhere. */
  key() {
    return [this.x, this.y, this.scale, this.width, this.height, window.devicePixelRatio].join();
  }
}
