// Time: scrubbing in the log, playing, single steps, slow motion, and the events of a simulation.

import { fixed, make } from "./plots.js";
import { send, sendSoon } from "./connection.js";
import { simulate } from "./controls.js";
import { on, onCalm, simulating, state } from "./store.js";
import { byId, choice, setText } from "./widgets.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
let modes = null;
let speeds = null;
let held = false;
const events = []; // of the simulation: {step, t_s, text}
let lastStep = null;

export function startTimeline() {
  modes = choice(byId("modes"), [["look", "Log", "Looks at the recorded log"], ["simulate", "Simulation", "Simulates from the time shown"]], (mode) => {
    if (mode === "simulate" && !simulating()) simulate();
    if (mode === "look" && simulating()) send("look", { t_us: clampTime(state.frame.t_us) });
  });
  speeds = choice(byId("speeds"), SPEEDS.map((speed) => [speed, `${speed}\u00d7`]), (speed) => send("play", { playing: Boolean(state.frame?.playing), speed }));
  const blurring = (id, action) => byId(id).addEventListener("click", (event) => { action(); if (event.detail > 0) byId(id).blur(); });
  blurring("play", togglePlay);
  blurring("back", back);
  blurring("on", step);
  blurring("reset", reset);
  const slider = byId("slider");
  slider.addEventListener("pointerdown", () => { held = true; });
  for (const end of ["pointerup", "pointercancel"]) slider.addEventListener(end, () => { held = false; slider.blur(); });
  slider.addEventListener("input", () => { if (!simulating()) sendSoon("look", { t_us: first() + Number(slider.value) }); });
  on("hello", ({ frames_us: frames = [] }) => {
    events.length = 0;
    lastStep = null;
    slider.max = frames.length ? frames[frames.length - 1] - frames[0] : 1;
    slider.step = 1000;
    marks();
  });
  on("frame", ({ header }) => note(header));
  onCalm(({ header }) => show(header));
}

const frames = () => state.hello?.frames_us ?? [];
const first = () => frames()[0] ?? 0;
const clampTime = (t) => Math.max(first(), Math.min(frames()[frames().length - 1] ?? t, t));

export function togglePlay() {
  if (state.frame && !state.frame.ended) send("play", { playing: !state.frame.playing });
}

// Index of the recorded frame at the time shown, or of the one before it.
function frameIndex() {
  let index = 0;
  frames().forEach((t, i) => { if (t <= (state.frame?.t_us ?? 0)) index = i; });
  return index;
}

/** One step of the simulation, or the next recorded frame. */
export function step() {
  if (!state.frame) return;
  if (simulating()) { if (!state.frame.ended) send("step", { count: 1 }); }
  else send("look", { frame: Math.min(frames().length - 1, frameIndex() + 1) });
}

/** The recorded frame before the one shown; a simulation does not run backward. */
export function back() {
  if (!state.frame || simulating()) return;
  const index = frameIndex();
  send("look", { frame: Math.max(0, frames()[index] < state.frame.t_us ? index : index - 1) });
}

export function reset() {
  if (simulating()) send("reset");
  else send("look", { frame: 0 });
}

function show(header) {
  const simulation = simulating();
  modes.set(header.mode);
  speeds.set(header.speed);
  const play = byId("play");
  setText(play, header.playing ? "Pause" : "Play");
  play.setAttribute("aria-pressed", Boolean(header.playing));
  play.disabled = Boolean(header.ended);
  byId("on").disabled = Boolean(header.ended);
  byId("back").disabled = simulation;
  const slider = byId("slider");
  slider.disabled = simulation;
  if (!held && document.activeElement !== slider) slider.value = header.t_us - first();
  slider.setAttribute("aria-valuetext", `${fixed(header.t_s ?? 0, 2)} s`);
  const total = (frames()[frames().length - 1] - first()) / 1e6;
  const where = simulation ? `step ${header.step ?? 0}` : `frame ${frameIndex() + 1} of ${frames().length}`;
  setText(byId("now"), `${where}, ${fixed(header.t_s ?? 0, 2)}${simulation ? "" : ` of ${fixed(total, 2)}`} s`);
}

function note(header) {
  const simulation = simulating();
  // A reset begins anew, and so does another simulation.
  const restarted = simulation ? lastStep === null || header.step < lastStep : lastStep !== null;
  lastStep = simulation ? header.step : null;
  if (restarted) events.length = 0;
  const news = header.events ?? [];
  events.push(...news);
  if (restarted || news.length) marks();
}

function marks() {
  const total = (frames()[frames().length - 1] - first()) / 1e6 || 1;
  byId("marks").replaceChildren(...events.slice(-200).map(({ t_s, text, step }) => {
    const mark = make("i", { class: "alert", title: `step ${step}, ${fixed(Number(t_s) || 0, 2)} s: ${text}` });
    mark.style.left = `${100 * Math.max(0, Math.min(1, t_s / total))}%`;
    return mark;
  }));
  const newest = events[events.length - 1];
  byId("marks").title = newest ? `${events.length} events, the last: ${newest.text}` : "";
}
