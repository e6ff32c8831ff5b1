// Sending robots from the map: a robot, then a click on the floor; and keep-out zones, drawn corner by corner.

import { request } from "./connection.js";
import { el, fixed, setText } from "./dom.js";
import { icon } from "./icons.js";
import { store } from "./store.js";

/** @import { Point } from "./types" */

const SNAP_PX = 14; // a click this near to a place means the place

export class MapSender {
  /** @type {Point[][]} Zones of this page; paths that it asks for avoid them. */
  zones = [];
  /** @type {Point[] | null} The corners of the zone that is being drawn. */
  drawn = null;
  select = el("select", { id: "send-robot" });
  zoneText = el("span", {}, "Draw a keep-out zone");
  zoneButton = el("button", { type: "button", "aria-pressed": "false" }, icon("zone"), this.zoneText);
  clearButton = el("button", { type: "button" }, "Clear zones");
  status = el("span", { class: "small faint grow", role: "status", id: "send-status" });
  node = el(
    "div",
    { class: "row grow sender" },
    el("label", { htmlFor: "send-robot" }, "Send"),
    this.select,
    this.zoneButton,
    this.clearButton,
    this.status,
  );
  #offered = "";

  /** @param {() => void} redraw */
  constructor(redraw) {
    this.redraw = redraw;
    this.select.onchange = () => this.explain();
    this.zoneButton.onclick = () => this.toggleZone();
    this.clearButton.onclick = () => {
      this.zones = [];
      this.drawn = null;
      this.explain();
    };
  }

  /** Offer the robots that can go to a point. */
  offer() {
    const names = store.mayCommand() ? store.names().filter((name) => store.robots[name]?.can_go) : [];
    if (names.join() === this.#offered && this.select.length) return;
    this.#offered = names.join();
    const chosen = this.select.value;
    const options = names.map((name) => el("option", { value: name }, name));
    this.select.replaceChildren(el("option", { value: "" }, names.length ? "no robot" : "no robot can go"), ...options);
    this.select.value = names.includes(chosen) ? chosen : "";
    this.explain();
  }

  explain() {
    this.clearButton.hidden = !this.zones.length;
    this.zoneButton.hidden = !store.hello?.world;
    this.zoneButton.setAttribute("aria-pressed", String(Boolean(this.drawn)));
    setText(this.zoneText, this.drawn ? "Close the zone" : "Draw a keep-out zone");
    if (this.drawn) setText(this.status, `Click the corners of the zone: ${this.drawn.length} so far.`);
    else if (this.select.value) setText(this.status, `Click where ${this.select.value} should go.`);
    else setText(this.status, "");
    this.redraw();
  }

  toggleZone() {
    if (this.drawn && this.drawn.length > 2) this.zones.push(this.drawn);
    this.drawn = this.drawn ? null : [];
    this.explain();
  }

  /**
   * Use a click on the floor; return whether it had a meaning here.
   *
   * @param {Point} point - in metres.
   * @param {number} scale - pixels of a metre.
   */
  click(point, scale) {
    if (this.drawn) {
      this.drawn.push(point);
      this.explain();
      return true;
    }
    if (!this.select.value) return false;
    this.send(this.select.value, point, scale);
    return true;
  }

  /** @param {string} robot @param {Point} point @param {number} scale */
  async send(robot, point, scale) {
    const place = store.hello?.world?.places.find(
      ({ x_m, y_m }) => Math.hypot(x_m - point[0], y_m - point[1]) * scale < SNAP_PX,
    );
    const [x_m, y_m] = place ? [place.x_m, place.y_m] : point;
    const goal = place ? place.name : `(${fixed(x_m, 2)}, ${fixed(y_m, 2)})`;
    setText(this.status, `${robot} goes to ${goal}.`);
    const answer = await request("send", { robot, x_m, y_m, keep_out: this.zones });
    setText(this.status, answer.ok ? `${robot} is at ${goal}.` : `${robot} does not get to ${goal}: ${answer.error}`);
  }
}
