// The frame of the page: views, the connection, STOP.

import { el, setText } from "./dom.js";
import { ask, begin, link } from "./link.js";
import { store } from "./store.js";
import { fleetView } from "./fleet.js";
import { mapView } from "./map.js";
import { camerasView, takeFrame } from "./cameras.js";
import { scenarioView } from "./scenario.js";
import { logsView } from "./logs.js";
import { robotView } from "./robot.js";
import { releaseAll, troubled } from "./drive.js";

const VIEWS = [
  ["fleet", "Fleet", fleetView],
  ["map", "Map", mapView],
  ["cameras", "Cameras", camerasView],
  ["scenario", "Scenario", scenarioView],
  ["logs", "Logs", logsView],
];
const byId = (id) => document.getElementById(id);
const main = byId("main");
let view = null, place = null, dirty = new Set(), isDue = false;

// Views.

function route() {
  const [name, argument] = location.hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
  const wanted = name === "robot" && argument ? `robot/${argument}` : (VIEWS.find(([key]) => key === name)?.[0] ?? "fleet");
  if (wanted === place) return;
  releaseAll();
  view?.leave?.();
  place = wanted;
  main.replaceChildren();
  main.className = "";
  view = wanted.startsWith("robot/") ? robotView(main, argument) : VIEWS.find(([key]) => key === wanted)[2](main);
  for (const anchor of byId("nav").children) {
    const isHere = anchor.dataset.view === wanted || (wanted.startsWith("robot/") && anchor.dataset.view === "fleet");
    isHere ? anchor.setAttribute("aria-current", "page") : anchor.removeAttribute("aria-current");
  }
  document.title = `${wanted} · ${store.hello?.fleet ?? "eal"}`;
  view.update(new Set(["hello", "robots", "poses", "run", "logs", "events"]));
}

store.onChange = (changed) => {
  for (const kind of changed) dirty.add(kind);
  if (changed.has("hello")) document.title = `${place} · ${store.hello.fleet}`;
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(() => {
    isDue = false;
    const now = dirty;
    dirty = new Set();
    if (now.has("robots") || now.has("hello")) showStop();
    view?.update(now);
  });
};

// The connection.

link.onState = () => {
  const chip = byId("connection");
  chip.className = `chip ${link.isOpen ? "good" : "bad"}`;
  setText(chip, link.isOpen ? "● connected" : `▲ no connection${link.refusal ? `: ${link.refusal}` : "; trying again"}`);
  if (!link.isOpen) troubled({ error: "the connection was lost" });
  setText(byId("fleet-name"), store.hello?.fleet ?? "eal");
  const permission = byId("permission");
  permission.hidden = store.mayCommand() || !store.hello;
  permission.className = "chip warn";
  setText(permission, `◇ ${store.hello?.why ?? ""}`);
  document.body.dataset.command = String(store.mayCommand() && link.isOpen);
  showStop();
};

link.onTrouble = (trouble) => {
  if (!troubled(trouble)) notify(trouble.robot ? `${trouble.robot}: ${trouble.error}` : trouble.error, true);
};
link.onFrame = takeFrame;

setInterval(() => {
  if (!link.isOpen) return;
  byId("connection").title = `${store.updatesPerSecond().toFixed(0)} updates a second`;
  document.body.dataset.rate = store.updatesPerSecond().toFixed(1);
}, 500);

// Notices.

export function notify(text, isBad = false) {
  const close = el("button", { type: "button", "aria-label": "Dismiss" }, "×");
  const notice = el("div", { class: `notice${isBad ? " bad" : ""}` }, el("span", {}, text), close);
  const remove = () => notice.remove();
  close.onclick = remove;
  setTimeout(remove, 12000);
  byId("notices").append(notice);
  while (byId("notices").children.length > 4) byId("notices").firstChild.remove();
}

// Stop: from every view, by a click or by Escape, and nothing comes before it.

async function stop() {
  releaseAll();
  if (!store.mayCommand() || !link.isOpen) {
    notify(link.isOpen ? `STOP was not sent: ${store.hello?.why}` : "STOP was not sent: there is no connection", true);
    return;
  }
  const answer = await ask({ do: "stop" });
  if (answer.ok) notify(`${answer.confirmed.length} robots confirmed the stop.`);
  else notify(`Not confirmed: ${Object.entries(answer.failed ?? {}).map(([name, why]) => `${name} (${why})`).join(", ") || answer.error}`, true);
}

function showStop() {
  const stopped = store.stopped();
  byId("stopped").hidden = !stopped.length;
  if (stopped.length) {
    const who = stopped.length === store.names().length ? "All robots" : stopped.slice(0, 4).join(", ") + (stopped.length > 4 ? ` and ${stopped.length - 4} more` : "");
    setText(byId("stopped-why"), `${who} refuse to move: ${store.robots[stopped[0]].stopped}.`);
  }
  byId("stop").setAttribute("aria-disabled", String(!(store.mayCommand() && link.isOpen)));
  byId("resume").disabled = !store.mayCommand();
}

byId("stop").onclick = stop;
window.addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || event.repeat) return;
  event.preventDefault();
  byId("confirm").close();
  stop();
}, { capture: true });

byId("resume").onclick = () => byId("confirm").showModal();
byId("confirm-no").onclick = () => byId("confirm").close();
byId("confirm-yes").onclick = async () => {
  byId("confirm").close();
  const answer = await ask({ do: "resume" });
  if (!answer.ok) notify(`Not resumed: ${Object.keys(answer.failed ?? {}).join(", ") || answer.error}`, true);
};

for (const [key, title] of VIEWS) byId("nav").append(el("a", { href: `#/${key}`, "data-view": key }, title));
document.querySelector(".skip").onclick = (event) => {
  event.preventDefault();
  main.focus();
};
begin();
window.addEventListener("hashchange", route);
route();
