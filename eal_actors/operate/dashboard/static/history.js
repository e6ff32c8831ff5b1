// The poses of the last minutes, and the bar that plays them back on a map.

import { el, formatSeconds, setText } from "./dom.js";

/** @import { Pose } from "./types" */
/** @typedef {{ at: number, poses: Record<string, Pose> }} Moment When, by this page's clock in ms, and the poses. */

const STEP_MS = 250;
const MOST_MS = 600_000;
/** @type {Moment[]} */
let moments = [];

/** @param {Record<string, Pose>} poses - of now; the entries are never changed afterwards. */
export function notePoses(poses) {
  const now = performance.now();
  if (moments.length && now - moments[moments.length - 1].at < STEP_MS) return;
  moments.push({ at: now, poses: { ...poses } });
  if (now - moments[0].at > 1.1 * MOST_MS) moments = moments.filter((moment) => now - moment.at <= MOST_MS);
}

/** Forget the poses of another connection's fleet. */
export function forgetPoses() {
  moments = [];
}

export class PlaybackBar {
  /** When the shown moment was, by this page's clock in ms; null while the map is live. */
  /** @type {number | null} */
  shownAt = null;
  isPlaying = false;
  #tickedAt = 0;
  live = el("button", { type: "button", "aria-pressed": "true" }, "● Live");
  play = el("button", { type: "button", "aria-label": "Play back the last minute" }, "▶");
  slider = el("input", { type: "range", min: "0", max: "0", value: "0", class: "grow", "aria-label": "Playback" });
  text = el("output", { class: "small number" });
  node = el("div", { class: "playback" }, this.live, this.play, this.slider, this.text);

  /** @param {() => void} onChange */
  constructor(onChange) {
    this.onChange = onChange;
    this.live.onclick = () => this.show(null);
    this.play.onclick = () => this.toggle();
    this.slider.oninput = () => this.show(performance.now() + Number(this.slider.value) * 1000);
    this.tick();
  }

  toggle() {
    this.isPlaying = !this.isPlaying;
    this.#tickedAt = performance.now();
    if (this.isPlaying && this.shownAt === null) this.show(performance.now() - 60_000);
    this.tick();
  }

  /** @param {number | null} at */
  show(at) {
    const first = moments[0]?.at ?? 0;
    this.shownAt = at === null || at >= performance.now() - STEP_MS ? null : Math.max(at, first);
    if (this.shownAt === null) this.isPlaying = false;
    this.tick();
    this.onChange();
  }

  /** Update the bar, and go on playing. Call it about as often as the map is drawn. */
  tick() {
    const now = performance.now();
    if (this.isPlaying && this.shownAt !== null) {
      this.shownAt += now - this.#tickedAt;
      if (this.shownAt >= now - STEP_MS) this.shownAt = null;
      this.isPlaying = this.shownAt !== null;
    }
    this.#tickedAt = now;
    const age_s = this.shownAt === null ? 0 : (now - this.shownAt) / 1000;
    const span_s = moments.length ? (now - moments[0].at) / 1000 : 0;
    this.slider.min = String(-Math.ceil(span_s));
    if (document.activeElement !== this.slider || this.shownAt === null || this.isPlaying) {
      this.slider.value = String(-age_s);
    }
    this.live.setAttribute("aria-pressed", String(this.shownAt === null));
    setText(this.play, this.isPlaying ? "❚❚" : "▶");
    this.play.setAttribute("aria-label", this.isPlaying ? "Pause the playback" : "Play back the last minute");
    setText(this.text, this.shownAt === null ? "now" : `${formatSeconds(age_s)} ago`);
  }

  /**
   * Return the poses to show: the present ones, or those of the chosen moment.
   *
   * @param {Record<string, Pose>} present
   */
  poses(present) {
    const { shownAt } = this;
    if (shownAt === null || !moments.length) return present;
    return (moments.findLast((moment) => moment.at <= shownAt) ?? moments[0]).poses;
  }
}
