// Keyboard and gamepad: sent at once when they change, and 20 times a second while they are held.

import { send } from "./connection.js";
import { handOver, simulate } from "./controls.js";
import { on, simulating, state } from "./store.js";
import { notice } from "./status.js";
import { back, reset, step, togglePlay } from "./timeline.js";
import { layout, nextLayer, setCamera, setMap } from "./view.js";
import { byId } from "./widgets.js";

const INTERVAL_MS = 50;
const DEAD_ZONE = 0.08;
const DRIVE = new Map([
  ["KeyW", "up"], ["ArrowUp", "up"], ["KeyS", "down"], ["ArrowDown", "down"],
  ["KeyA", "left"], ["ArrowLeft", "left"], ["KeyD", "right"], ["ArrowRight", "right"],
]);

const held = new Set(); // codes of the keys
let number = 0; // of the newest message
let timer = null;
let last = "";
let pads = 0;
let starting = false; // a key began a simulation that no frame shows yet
let leaving = false; // the log was asked for, and no frame shows it yet

/** Number of the newest message of controls; the header of a frame names the one that it shows. */
export const keysNumber = () => number;

export function startKeys() {
  window.addEventListener("keydown", down);
  window.addEventListener("keyup", up);
  window.addEventListener("blur", release);
  document.addEventListener("visibilitychange", () => { if (document.hidden) release(); });
  window.addEventListener("gamepadconnected", () => { pads++; byId("gamepad").hidden = false; tick(); });
  window.addEventListener("gamepaddisconnected", () => { pads = Math.max(0, pads - 1); byId("gamepad").hidden = pads === 0; });
  on("hello", () => {
    last = "";
    starting = false;
    leaving = false;
  });
  // Keys that are still held do not take the wheel back, nor the simulation.
  on("handover", () => held.clear());
  on("frame", ({ header }) => {
    if (header.mode === "simulate") starting = false;
    else {
      leaving = false;
      if (!starting) held.clear();
    }
  });
  on("sending", (type) => {
    if (type === "look") {
      held.clear();
      starting = false;
      leaving = true;
    } else if (type === "simulate") leaving = false;
  });
}

// Fields with their own keys keep them.
function taken(event) {
  const node = event.target;
  if (!(node instanceof Element)) return false;
  if (node.matches("input[type=text], input[type=number], select, textarea")) return true;
  if (node.matches("input[type=range], [role=slider]")) return event.key.startsWith("Arrow") || ["Home", "End"].includes(event.key);
  return event.code === "Space" && node.matches("button, a, input");
}

// Space brakes while a person drives, otherwise it plays and pauses.
const braking = () => simulating() && state.frame.playing && state.frame.by === "person" && state.youDrive;

function down(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape") {
    if (event.target instanceof HTMLElement && event.target !== document.body) event.target.blur();
    else setCamera(null);
    return;
  }
  if (taken(event)) return;
  if (DRIVE.has(event.code) || (event.code === "Space" && (braking() || held.has("Space")))) {
    event.preventDefault();
    if (event.repeat || held.has(event.code)) return;
    if (!state.youDrive) {
      notice("Another client drives. Take the wheel first.");
      return;
    }
    if (!simulating()) {
      if (DRIVE.get(event.code) !== "up") return;
      simulate();
      starting = true;
    }
    held.add(event.code);
    sendNow();
    return;
  }
  const map = state.hello?.maps?.[Number(event.key) - 1];
  const actions = {
    " ": togglePlay, p: togglePlay, ",": back, ".": step, r: () => { if (simulating()) reset(); }, b: nextLayer,
    l: () => { if (simulating()) handOver("log"); },
    e: () => setCamera(layout.camera === null ? enlarged() : null),
  };
  const action = map ? () => setMap(map) : actions[event.key.toLowerCase()];
  if (!action) return;
  event.preventDefault();
  if (!event.repeat || event.key === "," || event.key === ".") action();
}

// The camera below the pointer, or the one that faces ahead.
function enlarged() {
  const names = (state.hello?.cameras ?? []).map(({ name }) => name);
  const over = document.querySelector(".cell:hover")?.dataset.camera;
  return over ?? names.find((name) => /^(CAM_)?(FRONT|F0)$/i.test(name)) ?? names[0] ?? null;
}

function up(event) {
  if (held.delete(event.code)) sendNow();
}

/** Lets go of all keys. */
export function release() {
  if (!held.size) return;
  held.clear();
  sendNow();
}

function controls() {
  const on = (name) => Number([...held].some((code) => DRIVE.get(code) === name));
  let [throttle, steer, brake] = [on("up") - on("down"), on("left") - on("right"), Number(held.has("Space"))];
  for (const pad of pads ? navigator.getGamepads() : []) {
    if (!pad?.connected) continue;
    const axis = pad.axes[0] ?? 0;
    if (Math.abs(axis) > DEAD_ZONE) steer -= axis;
    const [slow, fast] = [pad.buttons[6]?.value ?? 0, pad.buttons[7]?.value ?? 0];
    if (fast > DEAD_ZONE) throttle += fast;
    if (slow > DEAD_ZONE) brake = Math.max(brake, slow);
  }
  const clamp = (value, low) => Math.max(low, Math.min(1, value));
  return { throttle: clamp(throttle, -1), steer: clamp(steer, -1), brake: clamp(brake, 0) };
}

function sendNow() {
  if (leaving || (!simulating() && !starting)) return;
  const now = controls();
  last = JSON.stringify(now);
  send("keys", { ...now, number: ++number });
  schedule();
}

const schedule = () => { timer ??= setTimeout(tick, INTERVAL_MS); };

function tick() {
  timer = null;
  const now = controls();
  const idle = !now.throttle && !now.steer && !now.brake;
  const changed = JSON.stringify(now) !== last;
  // A gamepad at rest does not take the wheel.
  const first = last === "" && idle;
  if (state.youDrive && simulating() && !first && (held.size || (pads && (changed || !idle)))) {
    sendNow();
  } else if (held.size || pads) schedule();
}
