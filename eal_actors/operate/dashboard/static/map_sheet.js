// A layer of the map that changes seldom: drawn on a canvas of its own, and copied from there in every frame.

import { fitCanvas } from "./dom.js";

/** @typedef {CanvasRenderingContext2D} Context */

export class Sheet {
  canvas = document.createElement("canvas");
  #key = "";

  /**
   * Copy the layer to a context; draw it anew if its key has changed.
   *
   * @param {Context} context
   * @param {number} width
   * @param {number} height
   * @param {string} key - differs whenever the layer does.
   * @param {(sheet: Context) => void} draw
   */
  show(context, width, height, key, draw) {
    if (key !== this.#key) {
      this.#key = key;
      const sheet = fitCanvas(this.canvas, width, height);
      sheet.clearRect(0, 0, width, height);
      draw(sheet);
    }
    if (!this.canvas.width || !this.canvas.height) return;
    context.save();
    context.setTransform(1, 0, 0, 1, 0, 0); // pixel by pixel: nothing is scaled
    context.drawImage(this.canvas, 0, 0);
    context.restore();
  }
}
