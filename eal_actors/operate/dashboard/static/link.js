// The connection: news go into the store, answers to whoever asked. It comes back by itself when it was lost.

import { store } from "./store.js";

const RETRY_MS = [300, 1000, 2000, 5000];
const waiting = new Map();
let socket = null, number = 0, retries = 0, token = null;

export const link = { onState: () => {}, onTrouble: () => {}, onFrame: () => {}, isOpen: false, refusal: null };

export function begin() {
  token = takeToken();
  connect();
}

// The token stands behind the # of the link, which is sent to nobody. It leaves the address bar at once.
function takeToken() {
  const match = /^#token=([\w-]+)$/.exec(location.hash);
  if (match) {
    sessionStorage.setItem("token", match[1]);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token");
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  socket = new WebSocket(`${scheme}://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => socket.send(JSON.stringify({ do: "hello", token }));
  socket.onmessage = (event) => (typeof event.data === "string" ? hear(JSON.parse(event.data)) : hearFrame(event.data));
  socket.onclose = (event) => {
    link.isOpen = false;
    for (const settle of waiting.values()) settle({ ok: false, error: "the connection to the dashboard was lost" });
    waiting.clear();
    const wait = RETRY_MS[Math.min(retries++, RETRY_MS.length - 1)];
    link.refusal = event.reason || null;
    link.onState();
    setTimeout(connect, wait);
  };
}

function hear(message) {
  if (message.hello) {
    retries = 0;
    link.isOpen = true;
    link.refusal = null;
    store.greet(message.hello);
    link.onState();
    return;
  }
  for (const answer of message.answers || []) {
    if (answer.trouble) link.onTrouble(answer.trouble);
    const settle = waiting.get(answer.id);
    if (settle) {
      waiting.delete(answer.id);
      settle(answer);
    } else if (answer.ok === false) link.onTrouble({ error: answer.error });
  }
  store.take(message);
}

function hearFrame(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  link.onFrame(header, buffer.byteLength > 4 + length ? new Blob([new Uint8Array(buffer, 4 + length)], { type: "image/jpeg" }) : null);
}

// Say something that is not answered.
export function say(message) {
  if (!link.isOpen) return false;
  socket.send(JSON.stringify(message));
  return true;
}

// Ask for something; the promise always comes to an answer, `ok` or not.
export function ask(message) {
  const id = ++number;
  return new Promise((resolve) => {
    waiting.set(id, resolve);
    if (!say({ ...message, id })) {
      waiting.delete(id);
      resolve({ ok: false, error: "there is no connection to the dashboard" });
    }
  });
}
