// Plots that grow: speed, acceleration, and deviation from the recorded path.

import { make, plotCurve } from "./plots.js";
import { on, simulating, state } from "./store.js";
import { byId } from "./widgets.js";

const PLOTS = [
  { key: "speed_mps", title: "Speed", unit: "m/s", digits: 1, least: 2 },
  { key: "acceleration_mps2", title: "Acceleration", unit: "m/s\u00b2", least: 2 },
  { key: "lateral_m", title: "Left of log", unit: "m", least: 1 },
  { key: "heading_rad", title: "Heading off log", unit: "\u00b0", factor: 180 / Math.PI, digits: 1, least: 4 },
];
/** Seconds of the plots. */
const SPAN_S = 30;
const REDRAW_MS = 200;
/** A jump in time begins the plots anew, seconds. */
const JUMP_S = 1.5;

const samples = []; // {t, values}
let mode = null;
let takeover = null; // time of it, seconds
let cards = [];
let dirty = false;

export function startTraces() {
  cards = PLOTS.map((options) => {
    const card = byId("plots").appendChild(make("div", { class: "card plot" }));
    const heading = card.appendChild(make("h2", {}, `${options.title} (${options.unit}) `));
    return { options, value: heading.appendChild(make("span", { class: "value" })), svg: card.appendChild(make("svg", { role: "img", "aria-label": options.title })) };
  });
  on("frame", ({ header }) => add(header));
  window.addEventListener("resize", () => { dirty = true; });
  setInterval(draw, REDRAW_MS);
  dirty = true;
}

function add(header) {
  const t = header.t_s;
  if (typeof t !== "number") return;
  const last = samples[samples.length - 1];
  if (header.mode !== mode || (last && (t < last.t || t > last.t + JUMP_S))) {
    samples.length = 0;
    takeover = null;
  }
  mode = header.mode;
  if (simulating() && header.takeover === null) takeover = null;
  else if (simulating() && takeover === null) takeover = t;
  const values = PLOTS.map(({ key, factor = 1 }) => (typeof header.ego?.[key] === "number" ? header.ego[key] * factor : null));
  if (samples[samples.length - 1]?.t === t) samples.pop();
  samples.push({ t, values });
  while (samples[0].t < t - SPAN_S) samples.shift();
  dirty = true;
}

function draw() {
  if (!dirty || document.hidden || !state.frame || !samples.length) return;
  dirty = false;
  const times = samples.map(({ t }) => t);
  cards.forEach(({ options, value, svg }, i) => {
    svg.replaceChildren();
    // The warm-up by the log is shaded.
    const warmUntil = mode === "simulate" ? takeover ?? times[times.length - 1] : null;
    const plot = plotCurve(svg, { times, leastSpan: 2, values: samples.map(({ values }) => values[i]), digits: options.digits, least: options.least, zeroLine: true, warmUntil, value });
    plot.cursor(times.length - 1);
  });
}
