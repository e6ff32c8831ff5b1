// Gamepads of this machine, by the browser's Gamepad API: standard mapping, left stick, a shoulder button as dead-man.

const PERIOD_MS = 50;
const DEAD_ZONE = 0.12;
/** Left and right shoulder button of the standard mapping. */
const DEAD_MEN = [4, 5];

/**
 * Return the curved value of a stick's axis: 0 within the dead zone, fine near it, 1 at the end.
 *
 * @param {number} value
 */
export function curved(value) {
  const size = Math.min(1, Math.max(0, (Math.abs(value) - DEAD_ZONE) / (1 - DEAD_ZONE)));
  return Math.sign(value) * (0.4 * size + 0.6 * size ** 3);
}

function knownPads() {
  return (navigator.getGamepads?.() ?? []).filter((pad) => pad?.connected && pad.mapping === "standard");
}

/** Return a gamepad whose dead-man button is held. @param {(Gamepad | null)[]} pads */
function heldOf(pads) {
  return pads.find((pad) => pad && DEAD_MEN.some((button) => pad.buttons[button]?.pressed));
}

/**
 * Reads the gamepads while a panel is armed. The stick counts only while a shoulder button is held. A button that is
 * held at the beginning, or while the gamepad or the focus is lost, must be released and pressed again.
 */
export class GamepadReader {
  /** @type {ReturnType<typeof setInterval> | null} */
  #timer = null;
  #wasHeld = false;
  #mustRelease = false;

  /** @param {(stick: { ahead: number, left: number } | null) => void} onStick - null when the dead-man is released. */
  constructor(onStick) {
    this.onStick = onStick;
  }

  /** @param {boolean} isOn */
  set(isOn) {
    if (isOn && this.#timer === null) {
      this.#mustRelease = Boolean(heldOf(knownPads()));
      this.#timer = setInterval(() => this.#read(), PERIOD_MS);
    }
    if (isOn || this.#timer === null) return;
    clearInterval(this.#timer);
    this.#timer = null;
    this.#end();
  }

  /** Ignore the button that is held, until it is released. */
  forget() {
    this.#mustRelease ||= this.#wasHeld;
  }

  #read() {
    const pads = knownPads();
    const held = heldOf(pads);
    const isAway = pads.length === 0 || document.hidden || !document.hasFocus();
    if (isAway) this.#mustRelease ||= this.#wasHeld || Boolean(held);
    else if (!held) this.#mustRelease = false;
    if (!held || isAway || this.#mustRelease) {
      this.#end();
      return;
    }
    this.#wasHeld = true;
    this.onStick({ ahead: curved(-held.axes[1]), left: curved(-held.axes[0]) });
  }

  #end() {
    if (this.#wasHeld) this.onStick(null);
    this.#wasHeld = false;
  }
}
