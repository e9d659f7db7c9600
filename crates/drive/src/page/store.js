// State of the page as the server reports it, and events between the modules.

export const state = {
  connected: false,
  hello: null, // the newest `hello`
  view: {}, // what is drawn
  frame: null, // header of the newest frame shown
  youDrive: false,
  clients: 0,
};

const listeners = new Map();

/** Calls `listener` at every event `name`. */
export function on(name, listener) {
  if (!listeners.has(name)) listeners.set(name, []);
  listeners.get(name).push(listener);
}

/** Time between texts, ms. */
const CALM_MS = 200;
let newest = null;
let calmTimer = null;
let calmedAt = -Infinity;
let shownState = "";

/** Calls `listener` with the newest frame, five times a second: for texts, whose layout costs more than pictures. */
export function onCalm(listener) {
  if (!listeners.has("calm")) on("frame", calm);
  on("calm", listener);
}

// What keys and buttons change is shown at once.
function calm(frame) {
  const { mode, by, playing, ended, takeover, speed } = frame.header;
  const key = [mode, by, playing, ended, takeover, speed].join();
  const wait = key === shownState ? calmedAt + CALM_MS - performance.now() : 0;
  newest = frame;
  shownState = key;
  if (wait > 0) {
    calmTimer ??= setTimeout(emitCalm, wait);
    return;
  }
  clearTimeout(calmTimer);
  emitCalm();
}

function emitCalm() {
  calmTimer = null;
  calmedAt = performance.now();
  emit("calm", newest);
}

/** Calls the listeners of `name` in the order of registration. An error in one does not stop the others. */
export function emit(name, data) {
  for (const listener of listeners.get(name) ?? []) {
    try {
      listener(data);
    } catch (error) {
      reportError(error);
    }
  }
}

/** Whether a simulation runs or is paused, as opposed to looking at the log. */
export const simulating = () => state.frame?.mode === "simulate";

/** A text for the name of a driver. */
export function driverText(by) {
  if (by === "log") return "log drives";
  if (by === "person") return state.youDrive ? "you drive" : "another person drives";
  return `policy ${by} drives`;
}
