// The bird's-eye view: the ego is in the middle and faces up. Dragging moves the ego, the wheel turns it.

import { make } from "./plots.js";
import { send, sendSoon } from "./connection.js";
import { emit, on, onCalm, simulating, state } from "./store.js";
import { byId, setText } from "./widgets.js";

const REACH_M = 40;
const EGO_M = [4.8, 1.9];
/** Movement below this is a click, pixels. */
const CLICK_PX = 4;
const TURN_DEG = 2;

let drag = null;
let selected = null; // track
const shapes = [];
let path = null; // of the picked actor: recorded centers, global meters
let line = null;

export function startBirdseye() {
  const canvas = byId("birdseye");
  on("hello", () => {
    const side = Math.round(Math.min(640, Math.max(240, canvas.clientWidth * devicePixelRatio)));
    if (!state.view.birdseye) send("view", { birdseye: { reach_m: REACH_M, side_px: side } });
  });
  on("frame", draw);
  onCalm(({ header }) => {
    const text = simulating() ? "a simulation moves the ego: choose Log to move it" : "drag: move the ego, wheel or shift: turn";
    setText(byId("birdseye-hint"), text);
    byId("above").classList.toggle("movable", !simulating());
    if (!drag) actors(header);
  });
  on("select", (track) => { selected = track; path = null; });
  on("path", (centers) => { path = centers; });
  const svg = byId("birdseye-actors");
  svg.addEventListener("pointerdown", begin);
  svg.addEventListener("pointermove", move);
  svg.addEventListener("pointerup", end);
  svg.addEventListener("pointercancel", end);
  svg.addEventListener("wheel", turn, { passive: false });
}

function draw({ header, images }) {
  const image = images.find(({ camera, map }) => camera === "" && map === "birdseye");
  if (drag) return; // the ground rests while the ego is moved over it
  if (image?.bitmap) paint(image);
  if (selected !== null) actors(header); // its outline moves with it
}

function paint({ width, height, bitmap }) {
  const canvas = byId("birdseye");
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  canvas.getContext("2d", { alpha: false }).drawImage(bitmap, 0, 0);
}

const reach = (header) => header?.birdseye?.reach_m ?? header?.reach_m ?? state.view.birdseye?.reach_m ?? REACH_M;

// Coordinates of the SVG are meters: x to the right, y down.
function actors(header) {
  const svg = byId("birdseye-actors");
  const r = reach(header);
  svg.setAttribute("viewBox", `${-r} ${-r} ${2 * r} ${2 * r}`);
  const { x: ex = 0, y: ey = 0, yaw_rad: yaw = 0 } = header.ego ?? {};
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  const list = header.actors ?? [];
  line ??= svg.appendChild(make("polyline", { class: "path" }));
  const inView = (x, y) => `${(y - ey) * -cos + (x - ex) * sin},${-((x - ex) * cos + (y - ey) * sin)}`;
  line.setAttribute("points", (path ?? []).map(([x, y]) => inView(x, y)).join(" "));
  while (shapes.length < list.length) shapes.push(svg.appendChild(make("rect", { class: "actor" })));
  shapes.forEach((shape, i) => {
    const actor = list[i];
    shape.style.display = actor ? "" : "none";
    if (!actor) return;
    const [dx, dy] = [actor.x - ex, actor.y - ey];
    const [forward, left] = [dx * cos + dy * sin, dy * cos - dx * sin];
    shape.setAttribute("x", -actor.width / 2);
    shape.setAttribute("y", -actor.length / 2);
    shape.setAttribute("width", actor.width);
    shape.setAttribute("height", actor.length);
    shape.setAttribute("transform", `translate(${-left} ${-forward}) rotate(${(-180 / Math.PI) * (actor.yaw_rad - yaw)})`);
    shape.classList.toggle("selected", actor.track === selected);
    shape.dataset.track = actor.track;
  });
}

function meters(event) {
  const box = byId("birdseye-actors").getBoundingClientRect();
  const scale = (2 * reach(state.frame)) / box.width;
  return { x: (event.clientX - box.left - box.width / 2) * scale, y: (event.clientY - box.top - box.height / 2) * scale };
}

function begin(event) {
  if (event.button !== 0 || !state.frame) return;
  const start = meters(event);
  const offset = state.frame.offset ?? {};
  drag = { start, moved: false, px: [event.clientX, event.clientY], turning: event.shiftKey, offset: { forward_m: 0, left_m: 0, yaw_deg: 0, ...offset }, track: event.target.dataset?.track, ghost: null };
  byId("birdseye-actors").setPointerCapture?.(event.pointerId);
}

function move(event) {
  if (!drag || simulating()) return;
  if (!drag.moved && Math.hypot(event.clientX - drag.px[0], event.clientY - drag.px[1]) < CLICK_PX) return;
  drag.moved = true;
  const at = meters(event);
  drag.ghost ??= byId("birdseye-actors").appendChild(make("rect", { class: "ghost", x: -EGO_M[1] / 2, y: -EGO_M[0] / 2, width: EGO_M[1], height: EGO_M[0] }));
  const { forward_m, left_m, yaw_deg } = drag.offset;
  if (drag.turning) {
    const degrees = (Math.atan2(-at.x, -at.y) - Math.atan2(-drag.start.x, -drag.start.y)) * 180 / Math.PI;
    drag.ghost.setAttribute("transform", `rotate(${-degrees})`);
    sendSoon("look", { yaw_deg: wrap(yaw_deg + degrees) });
    return;
  }
  const [forward, left] = [drag.start.y - at.y, drag.start.x - at.x];
  drag.ghost.setAttribute("transform", `translate(${-left} ${-forward})`);
  // The offset is relative to the recorded heading, the picture to the turned one.
  const [cos, sin] = [Math.cos(yaw_deg * Math.PI / 180), Math.sin(yaw_deg * Math.PI / 180)];
  sendSoon("look", { forward_m: forward_m + cos * forward - sin * left, left_m: left_m + sin * forward + cos * left });
}

function end() {
  if (!drag) return;
  drag.ghost?.remove();
  if (!drag.moved && drag.track) emit("select", drag.track);
  drag = null;
}

function turn(event) {
  event.preventDefault();
  if (simulating() || !state.frame || drag) return;
  const degrees = (state.frame.offset?.yaw_deg ?? 0) - Math.sign(event.deltaY) * TURN_DEG;
  sendSoon("look", { yaw_deg: wrap(degrees) });
}

const wrap = (degrees) => ((degrees + 180) % 360 + 360) % 360 - 180;
