// Dragging, pinching, scrolling and clicking on a map.

/** @typedef {{ x: number, y: number, moved: number }} Pointer */
/**
 * @typedef {{
 *   pan: (dx: number, dy: number) => void,
 *   zoom: (factor: number, x?: number, y?: number) => void,
 *   fit: () => void,
 *   click: (x: number, y: number) => void,
 * }} Actions
 */

const DRAG_PX = 6; // a pointer that moved farther is no click
export const ZOOM = 1.3;

/** @param {HTMLCanvasElement} canvas @param {Actions} actions */
export function listenTo(canvas, { pan, zoom, fit, click }) {
  /** @type {Map<number, Pointer>} Pointers that are down. */
  const pointers = new Map();
  let pinch = 0;

  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY, moved: 0 });
    pinch = 0;
  };
  canvas.onpointermove = (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return;
    const dx = event.offsetX - pointer.x;
    const dy = event.offsetY - pointer.y;
    pointer.x = event.offsetX;
    pointer.y = event.offsetY;
    pointer.moved += Math.abs(dx) + Math.abs(dy);
    if (pointers.size !== 2) {
      pan(dx, dy);
      return;
    }
    const [a, b] = [...pointers.values()];
    const distance = Math.hypot(a.x - b.x, a.y - b.y);
    if (pinch) zoom(distance / pinch, (a.x + b.x) / 2, (a.y + b.y) / 2);
    pinch = distance;
  };
  canvas.onpointerup = canvas.onpointercancel = (event) => {
    const pointer = pointers.get(event.pointerId);
    pointers.delete(event.pointerId);
    if (pointer && pointer.moved <= DRAG_PX && event.type === "pointerup") click(pointer.x, pointer.y);
  };
  canvas.onwheel = (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY);
  };
  canvas.onkeydown = ({ key }) => {
    if (key === "+") zoom(ZOOM);
    else if (key === "-") zoom(1 / ZOOM);
    else if (key === "0") fit();
  };
}
