// The frame of the page: views, the connection's state, notices and STOP.

import { camerasView } from "./cameras.js";
import { connect, connection, request, signIn } from "./connection.js";
import { byId, clockTime, el, setText } from "./dom.js";
import { releaseAll, showDriveError } from "./drive.js";
import { fleetView } from "./fleet.js";
import { showFrame } from "./frames.js";
import { icon } from "./icons.js";
import { logsView } from "./logs.js";
import { mapView } from "./map.js";
import { missionView } from "./mission.js";
import { robotView } from "./robot.js";
import { scenarioView } from "./scenario.js";
import { store } from "./store.js";

/** @import { Change, Failure, View } from "./types" */

/** @type {[string, string, (root: HTMLElement) => View][]} */
const VIEWS = [
  ["mission", "Mission", missionView],
  ["fleet", "Fleet", fleetView],
  ["map", "Map", mapView],
  ["cameras", "Cameras", camerasView],
  ["scenario", "Scenario", scenarioView],
  ["logs", "Logs", logsView],
];
const NOTICE_MS = 12000;
const LATE_MS = 1000;
const OUTDATED_S = 3;
const MAX_NOTICES = 4;
const MAX_NAMES = 4;
const main = byId("main");
const signInDialog = /** @type {HTMLDialogElement} */ (byId("sign-in"));
const dialog = /** @type {HTMLDialogElement} */ (byId("confirm"));
/** @type {View | null} */
let view = null;
/** @type {string | null} */
let place = null;
/** @type {Set<Change>} */
let changes = new Set();

// Views.

function route() {
  const [name, robot] = location.hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
  const entry = VIEWS.find(([key]) => key === name) ?? VIEWS[0];
  const wanted = name === "robot" && robot ? `robot/${robot}` : entry[0];
  if (wanted === place) return;
  releaseAll();
  view?.leave?.();
  place = wanted;
  main.replaceChildren();
  main.className = "";
  const isRobot = wanted.startsWith("robot/");
  view = isRobot ? robotView(main, robot) : entry[2](main);
  for (const anchor of byId("nav").querySelectorAll("a")) {
    if (anchor.dataset.view === (isRobot ? "fleet" : wanted)) anchor.setAttribute("aria-current", "page");
    else anchor.removeAttribute("aria-current");
  }
  showTitle();
  view.update(new Set(["hello", "robots", "poses", "run", "logs", "events"]));
}

function showTitle() {
  document.title = `${place} · ${store.hello?.fleet ?? "eal"}`;
}

// Updates come up to 60 times a second: the page is drawn at most once a frame.
store.onChange = (changed) => {
  const isDue = changes.size > 0;
  for (const kind of changed) changes.add(kind);
  if (changed.has("hello")) showTitle();
  if (isDue || !changes.size) return;
  requestAnimationFrame(() => {
    const now = changes;
    changes = new Set();
    if (now.has("robots") || now.has("hello")) showStop();
    view?.update(now);
  });
};

// The connection.

connection.onState = () => {
  if (!connection.isOpen) showDriveError({ error: "the connection was lost" });
  showAge();
  setText(byId("fleet-name"), store.hello?.fleet ?? "eal");
  const permission = byId("permission");
  permission.hidden = store.mayCommand() || !store.hello;
  setText(permission, `◇ ${store.hello?.why ?? ""}`);
  const user = byId("user");
  user.hidden = !store.hello || store.hello.user === "anybody";
  setText(user, `${store.hello?.user} · ${store.hello?.role}`);
  document.body.dataset.command = String(canCommand());
  showStop();
};
connection.onSignIn = (why) => {
  setText(byId("sign-in-why"), why);
  signInDialog.showModal();
};
byId("sign-in-form").onsubmit = (event) => {
  event.preventDefault();
  const field = /** @type {HTMLInputElement} */ (byId("sign-in-token"));
  signInDialog.close();
  signIn(field.value.trim());
  field.value = "";
};
connection.onDriveError = (error) => {
  if (!showDriveError(error)) connection.onError(error.robot ? `${error.robot}: ${error.error}` : error.error);
};
connection.onError = (error) => notify(error, true);
connection.onFrame = showFrame;

function canCommand() {
  return store.mayCommand() && connection.isOpen;
}

setInterval(() => {
  showAge();
  if (!connection.isOpen) return;
  byId("connection").title = `${store.updatesPerSecond().toFixed(0)} updates per second`;
  document.body.dataset.rate = store.updatesPerSecond().toFixed(1);
}, 500);

/** @param {boolean} isOutdated */
function showConnection(isOutdated) {
  const chip = byId("connection");
  const isGood = connection.isOpen && !isOutdated;
  chip.className = `chip ${isGood ? "good" : "bad"}`;
  const reason = connection.closeReason ? `: ${connection.closeReason}` : "";
  const lost = `▲ no connection${reason}${connection.isRetrying ? "; reconnecting" : ""}`;
  setText(chip, isGood ? "● connected" : connection.isOpen ? "▲ no answer" : lost);
}

// The server sends something every second. A page without it shows the past, and says so.
function showAge() {
  const heardAt = connection.heardAt;
  const age_s = heardAt ? (Date.now() - heardAt.getTime()) / 1000 : 0;
  const isOutdated = heardAt !== null && (age_s > OUTDATED_S || !connection.isOpen);
  byId("outdated").hidden = !isOutdated;
  document.body.classList.toggle("outdated", isOutdated);
  showConnection(isOutdated);
  if (!isOutdated) return;
  setText(byId("outdated-why"), `The dashboard was last seen at ${clockTime(heardAt)}. Robots may have moved since.`);
}

// Notices.

/** @param {string} text @param {boolean} [isBad] */
function notify(text, isBad = false) {
  const close = el("button", { type: "button", "aria-label": "Dismiss" }, "×");
  const notice = el("div", { class: `notice${isBad ? " bad" : ""}` }, el("span", {}, text), close);
  close.onclick = () => notice.remove();
  setTimeout(() => notice.remove(), NOTICE_MS);
  const notices = byId("notices");
  notices.append(notice);
  while (notices.children.length > MAX_NOTICES) notices.firstChild?.remove();
  return notice;
}

/** @param {Failure} answer */
function describeFailure(answer) {
  const robots = Object.entries(answer.failed ?? {}).map(([name, reason]) => `${name} (${reason})`);
  return robots.join(", ") || (answer.error ?? "");
}

// STOP: from every view, by the button or by Escape, and before anything else.

async function stop() {
  releaseAll();
  if (!canCommand()) {
    const reason = connection.isOpen ? (store.hello?.why ?? "") : "there is no connection";
    notify(`STOP was not sent: ${reason}`, true);
    return;
  }
  let warning = /** @type {HTMLElement | null} */ (null);
  const late = setTimeout(() => {
    warning = notify("STOP NOT CONFIRMED: no answer yet.", true);
  }, LATE_MS);
  const answer = await request("stop", {});
  clearTimeout(late);
  warning?.remove();
  if (answer.ok) notify(`${answer.confirmed.length} of ${store.names().length} robots confirmed the stop.`);
  else notify(`Stop not confirmed: ${describeFailure(answer)}`, true);
}

/** @param {string[]} names */
function list(names) {
  const rest = names.length - MAX_NAMES;
  return names.slice(0, MAX_NAMES).join(", ") + (rest > 0 ? ` and ${rest} more` : "");
}

function showStop() {
  const stopped = store.stopped();
  byId("stopped").hidden = !stopped.length;
  if (stopped.length) {
    const [total, missing] = [store.names().length, store.unconfirmed()];
    const count = `${stopped.length - missing.length} of ${total} stopped, ${list(missing)} NOT CONFIRMED`;
    const robots = stopped.length === total ? "All robots" : list(stopped);
    const state = missing.length ? count : `${robots} refuse to move`;
    setText(byId("stopped-word"), missing.length ? "▲ Stop not confirmed." : "■ Stopped.");
    setText(byId("stopped-why"), `${state}: ${store.robots[stopped[0]].stopped}.`);
  }
  byId("stop").setAttribute("aria-disabled", String(!canCommand()));
  /** @type {HTMLButtonElement} */ (byId("resume")).disabled = !store.mayCommand();
}

async function resume() {
  dialog.close();
  const answer = await request("resume", {});
  if (!answer.ok) notify(`Not resumed: ${describeFailure(answer)}`, true);
}

function stopAtOnce() {
  dialog.close();
  stop();
}

byId("stop").onclick = stopAtOnce;
window.addEventListener(
  "keydown",
  (event) => {
    if (event.key !== "Escape" || event.repeat) return;
    event.preventDefault();
    stopAtOnce();
  },
  { capture: true },
);
// Keys that are pressed inside the replay of a run do not reach this page: its player passes Escape on.
window.addEventListener("message", (event) => {
  const isOurs = [...document.querySelectorAll("iframe")].some((frame) => frame.contentWindow === event.source);
  if (isOurs && event.data === "Escape") stopAtOnce();
});
byId("resume").onclick = () => dialog.show(); // not modal: STOP must work beside it
byId("confirm-no").onclick = () => dialog.close();
byId("confirm-yes").onclick = resume;

for (const [key, title] of VIEWS)
  byId("nav").append(el("a", { href: `#/${key}`, "data-view": key }, icon(key), el("span", {}, title)));
byId("skip").onclick = (event) => {
  event.preventDefault();
  main.focus();
};
connect();
window.addEventListener("hashchange", route);
route();
