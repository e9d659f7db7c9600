// The WebSocket: reconnects by itself, decodes frames, acknowledges them once they are drawn.

import { parsePacket } from "./packet.js";
import { emit, state } from "./store.js";

const PROTOCOL = 1;
const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 5000;
/** Interval of messages that replace each other, such as those of sliders. */
const SOON_MS = 50;

let socket = null;
let attempts = 0;
let refused = false;
let waiting = null; // newest message that is not decoded yet
let decoding = false;
const pending = new Map(); // fields by type, for `sendSoon`
let timer = null;

/** Adds the token of the page's address to a path of the server. */
export function address(path, fields = {}) {
  const query = new URLSearchParams(fields);
  const token = new URLSearchParams(location.search).get("token");
  if (token) query.set("token", token);
  const text = query.toString();
  return text ? `${path}?${text}` : path;
}

export function connect() {
  const url = new URL(address("/live"), location.href);
  url.protocol = url.protocol.replace("http", "ws");
  socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  const own = socket;
  socket.onmessage = (event) => {
    if (own !== socket) return;
    if (typeof event.data === "string") receive(event.data);
    else receiveFrame(event.data);
  };
  socket.onclose = () => {
    if (own !== socket) return;
    socket = null;
    state.connected = false;
    state.youDrive = false;
    waiting = null;
    pending.clear();
    if (refused) return;
    const wait = Math.min(LONGEST_WAIT_MS, FIRST_WAIT_MS * 2 ** attempts) * (0.8 + 0.4 * Math.random());
    attempts++;
    emit("lost", { attempts });
    setTimeout(connect, wait);
  };
}

/** Closes the connection as a failure of the network would; it reconnects by itself. */
export function cut() {
  socket?.close();
}

/** Sends a message now. Returns whether there is a connection. */
export function send(type, fields = {}) {
  if (socket?.readyState !== WebSocket.OPEN) return false;
  emit("sending", type);
  // A move of the ego that still waits would end the simulation.
  if (type === "simulate") pending.delete("look");
  socket.send(JSON.stringify({ type, ...fields }));
  return true;
}

/** Sends within 50 ms; fields given in the meantime are merged, the newest value counts. */
export function sendSoon(type, fields) {
  pending.set(type, { ...pending.get(type), ...fields });
  timer ??= setTimeout(() => {
    timer = null;
    for (const [type, fields] of pending) send(type, fields);
    pending.clear();
  }, SOON_MS);
}

function receive(text) {
  let message;
  try {
    message = JSON.parse(text);
  } catch {
    return;
  }
  switch (message?.type) {
    case "hello":
      if (message.protocol !== PROTOCOL) {
        refused = true;
        emit("refused", { protocol: message.protocol });
        cut();
        return;
      }
      attempts = 0;
      state.connected = true;
      state.hello = message;
      state.view = message.view ?? {};
      if ("you_drive" in message) state.youDrive = Boolean(message.you_drive);
      emit("hello", message);
      emit("view", state.view);
      emit("who");
      break;
    case "view":
      state.view = message.view;
      emit("view", state.view);
      break;
    case "who":
      state.youDrive = Boolean(message.you_drive);
      state.clients = message.clients ?? state.clients;
      emit("who");
      break;
    case "counts":
      state.clients = message.clients ?? state.clients;
      emit("counts", message);
      break;
    case "progress":
    case "picked":
    case "saved":
    case "notice":
      emit(message.type, message);
      break;
    default: // of a later version
  }
}

function receiveFrame(buffer) {
  if (waiting) acknowledge(waiting.header);
  try {
    waiting = parsePacket(buffer);
  } catch (error) {
    reportError(error);
    return;
  }
  if (!decoding) decode();
}

const acknowledge = (header) => send("ack", { frame: header.frame });

// An image that a canvas can draw. WebCodecs needs no Blob, whose bytes pass through another process; it is there on
// secure origins, such as this computer.
async function decoded({ bytes, type }) {
  if (!("ImageDecoder" in window)) return createImageBitmap(new Blob([bytes], { type }));
  const decoder = new ImageDecoder({ data: bytes, type });
  const { image } = await decoder.decode();
  decoder.close();
  return image;
}

// All images of a frame are drawn at once, after the last is decoded.
async function decode() {
  decoding = true;
  while (waiting) {
    const { header, images } = waiting;
    const start = performance.now();
    waiting = null;
    const bitmaps = await Promise.all(images.map((image) => decoded(image).catch(() => null)));
    state.frame = header;
    emit("frame", { header, images: images.map((image, i) => ({ ...image, bitmap: bitmaps[i] })) });
    emit("drawn", { ms: performance.now() - start });
    for (const bitmap of bitmaps) bitmap?.close();
    if (document.hidden) await visible();
    acknowledge(header);
  }
  decoding = false;
}

// A page that nobody sees takes a frame a second.
function visible() {
  return new Promise((done) => {
    const finish = () => {
      clearTimeout(timeout);
      document.removeEventListener("visibilitychange", finish);
      done();
    };
    const timeout = setTimeout(finish, 1000);
    document.addEventListener("visibilitychange", finish);
  });
}
