// The websocket to the server. Updates go into the store, answers to their requests. A lost connection is opened again.

import { store } from "./store.js";

/**
 * @import { Answer, AnswerTo, DriveError, FrameHeader, Hello, Message, RequestName, Requests, Update } from "./types"
 */

/** The server's code for: show a token first. */
const SIGN_IN = 4401;
const RETRY_MS = [300, 1000, 2000, 5000];
/** @type {Map<number, (answer: Answer) => void>} */
const pending = new Map();
/** @type {WebSocket | null} */
let socket = null;
let lastId = 0;
let lossReason = "";
let retries = 0;
/** @type {string | null} */
let token = null;

export const connection = {
  isOpen: false,
  isRetrying: true,
  /** When the last message came, by this machine's clock; null before the first. */
  /** @type {Date | null} */
  heardAt: null,
  /** @type {string | null} Why the server closed the connection. */
  closeReason: null,
  onState: () => {},
  /** @type {(why: string) => void} Called when the server asks for a token; `signIn` goes on. */
  onSignIn: () => {},
  /** @type {(error: DriveError) => void} */
  onDriveError: () => {},
  /** @type {(error: string) => void} */
  onError: () => {},
  /** @type {(header: FrameHeader, jpeg: Blob | null) => void} */
  onFrame: () => {},
};

export function connect() {
  token = takeToken();
  open();
}

// The link's token is behind its #, so browsers send it to no server. It leaves the address bar at once.
function takeToken() {
  const match = /^#token=([\w.-]+)$/.exec(location.hash);
  if (match) {
    sessionStorage.setItem("token", match[1]);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token");
}

/** @param {string} shown - the token of the user. */
export function signIn(shown) {
  token = shown;
  open();
}

function open() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const opened = new WebSocket(`${scheme}://${location.host}/ws`);
  socket = opened;
  opened.binaryType = "arraybuffer";
  opened.onopen = () => opened.send(JSON.stringify({ do: "hello", token }));
  opened.onmessage = ({ data }) => {
    connection.heardAt = new Date();
    if (typeof data === "string") receive(JSON.parse(data));
    else receiveFrame(data);
  };
  opened.onclose = ({ code, reason }) => {
    connection.isOpen = false;
    const error = lossReason || "the connection to the dashboard was lost";
    lossReason = "";
    for (const resolve of pending.values()) resolve({ ok: false, error });
    pending.clear();
    connection.closeReason = reason || null;
    connection.isRetrying = code !== SIGN_IN;
    connection.onState();
    if (!connection.isRetrying) {
      sessionStorage.removeItem("token");
      connection.onSignIn(reason);
      return;
    }
    setTimeout(open, RETRY_MS[Math.min(retries++, RETRY_MS.length - 1)]);
  };
}

/** @param {{ hello: Hello } | Update} message */
function receive(message) {
  if ("hello" in message) {
    retries = 0;
    connection.isOpen = true;
    connection.closeReason = null;
    if (token && message.hello.user !== "anybody") sessionStorage.setItem("token", token);
    store.reset(message.hello);
    connection.onState();
    return;
  }
  if (!store.hasSameRobots(message)) {
    lossReason = "the fleet has other robots now";
    socket?.close(); // the fleet file was reloaded: the next connection begins with its robots
    return;
  }
  for (const answer of message.answers ?? []) {
    if ("drive_error" in answer) connection.onDriveError(answer.drive_error);
    else resolveRequest(answer);
  }
  store.apply(message);
}

/** @param {Answer} answer */
function resolveRequest(answer) {
  const resolve = pending.get(answer.id ?? -1);
  if (resolve) {
    pending.delete(answer.id ?? -1);
    resolve(answer);
  } else if (!answer.ok && answer.error) {
    connection.onError(answer.error);
  }
}

/** @param {ArrayBuffer} buffer - the header's length (4 bytes), the header as JSON, and a JPEG unless there is none. */
function receiveFrame(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const jpeg = new Uint8Array(buffer, 4 + length);
  connection.onFrame(header, jpeg.length ? new Blob([jpeg], { type: "image/jpeg" }) : null);
}

/** @param {object} message */
function transmit(message) {
  if (!connection.isOpen || !socket) return false;
  socket.send(JSON.stringify(message));
  return true;
}

/**
 * Send a message that has no answer; return false if there is no connection.
 *
 * @param {Message} message
 */
export function send(message) {
  return transmit(message);
}

/**
 * Send a request. The promise always resolves, with an answer or a failure.
 *
 * @template {RequestName} Name
 * @param {Name} name
 * @param {Requests[Name]} fields
 * @returns {Promise<AnswerTo<Name>>}
 */
export function request(name, fields) {
  const id = ++lastId;
  return new Promise((resolve) => {
    pending.set(id, (answer) => resolve(/** @type {AnswerTo<Name>} */ (answer)));
    if (!transmit({ do: name, ...fields, id, heard_s: store.heard_s })) {
      pending.delete(id);
      resolve({ ok: false, error: "there is no connection to the dashboard" });
    }
  });
}
