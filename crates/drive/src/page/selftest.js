// Tests of the page in a browser against a server: #selftest visits everything once, with #selftest&size=HxW on
// maps of that size (for programs without optimization); #random=N&seed=S does
// N random things; #show=look, drive, generated or picked leaves the page in a state for a screenshot. The result is written into the element `selftest`.

import { cut, send } from "./connection.js";
import { keysNumber, release } from "./keys.js";
import { on, simulating, state } from "./store.js";
import { canvasOf, layout, mapOf, mapsOf } from "./view.js";
import { byId } from "./widgets.js";

const LATENCY_TRIALS = 40;
const FPS_MS = 3000;
const errors = [];
const notices = [];

/** Collects errors of scripts and of the console, and notices of the server. */
export function watchErrors() {
  window.addEventListener("error", (event) => errors.push(event.message));
  window.addEventListener("unhandledrejection", (event) => errors.push(String(event.reason)));
  const original = console.error;
  console.error = (...parts) => { errors.push(parts.join(" ")); original(...parts); };
  on("notice", ({ level, text }) => { if (level === "error") notices.push(text); });
  on("lost", () => { received = 0; });
  on("frame", () => { received++; });
}
let received = 0; // frames since the connection was made

const SHOWN = "PASS: shown";

/** Runs a test and writes its result. */
export async function run(test) {
  let result;
  try {
    result = await test();
  } catch (error) {
    result = `FAIL: ${error.message}`;
  }
  if (errors.length) result = `FAIL: ${errors.slice(0, 5).join("; ")} (${result})`;
  byId("selftest").hidden = result === SHOWN;
  byId("selftest").textContent = result;
}

function expect(holds, text) {
  if (!holds) throw new Error(text);
}

const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

let patience = 1; // limits are multiplied by it

/** Waits until a condition holds; a failure names it. */
async function until(condition, text, limit = 10000) {
  const limitMs = limit * patience;
  const end = performance.now() + limitMs;
  while (!condition()) {
    expect(performance.now() < end, `${text}: not within ${limitMs / 1000} s`);
    await sleep(10);
  }
}

// Frames shown, for waits: tests of a condition run right after the frame is drawn.
let frameWaits = [];
on("frame", () => {
  const now = performance.now();
  frameWaits = frameWaits.filter((wait) => !wait(now));
});

/** Resolves with the time at which a frame that fulfils the condition was drawn. */
function frameWith(condition, text, limit = 10000) {
  const limitMs = limit * patience;
  return new Promise((done, fail) => {
    const timeout = setTimeout(() => fail(new Error(`${text}: not within ${limitMs / 1000} s`)), limitMs);
    frameWaits.push((now) => {
      if (!condition(state.frame)) return false;
      clearTimeout(timeout);
      done(now);
      return true;
    });
  });
}

const key = (code, type = "keydown") => {
  const name = code.startsWith("Key") ? code.slice(3).toLowerCase() : code === "Space" ? " " : code.startsWith("Digit") ? code.slice(5) : code;
  document.body.dispatchEvent(new KeyboardEvent(type, { code, key: name, bubbles: true, cancelable: true }));
};
const press = (code) => { key(code); key(code, "keyup"); };

function pointer(node, type, x, y, more = {}) {
  const Event = type === "click" || type === "dblclick" ? MouseEvent : PointerEvent;
  node.dispatchEvent(new Event(type, { bubbles: true, cancelable: true, clientX: x, clientY: y, pointerId: 1, buttons: type === "pointerup" ? 0 : 1, button: 0, detail: 1, ...more }));
}

function middle(node, right = 0.5, down = 0.5) {
  const box = node.getBoundingClientRect();
  return [box.left + box.width * right, box.top + box.height * down];
}

async function drag(node, from, to, more = {}) {
  pointer(node, "pointerdown", ...from, more);
  for (let i = 1; i <= 5; i++) {
    pointer(node, "pointermove", from[0] + (to[0] - from[0]) * i / 5, from[1] + (to[1] - from[1]) * i / 5, more);
    await sleep(20);
  }
  pointer(node, "pointerup", ...to, more);
}

function setSlider(node, value) {
  node.value = value;
  node.dispatchEvent(new Event("input", { bubbles: true }));
}

function setValue(node, value) {
  node.value = value;
  node.dispatchEvent(new Event("change", { bubbles: true }));
}

const pressed = (group, value) => byId(group).querySelector(`[data-value="${CSS.escape(value)}"]`)?.getAttribute("aria-pressed") === "true";
const choose = (group, value) => byId(group).querySelector(`[data-value="${CSS.escape(value)}"]`).click();

// Generated images begin with references, are marked, and end.
async function generatedImages(camera) {
  const label = () => document.querySelector(`[data-camera="${CSS.escape(camera)}"] .origin`).textContent;
  const mode = (name) => document.querySelector(`#generator [data-value="${name}"]`).click();
  choose("maps", "generated");
  await until(() => simulating() && state.frame.generated?.mode === "lockstep", "a simulation with generated images");
  await until(() => label().startsWith("reference"), "a reference image is marked");
  while (state.frame.generated.is_reference) {
    const { step } = state.frame;
    press(".");
    await until(() => state.frame.step > step && !state.frame.generated.is_waiting, "a step in lockstep", 60000);
    expect(!state.frame.generated.failure, state.frame.generated.failure);
  }
  await until(() => label().startsWith("generated"), "a generated image is marked");
  mode("beside");
  await until(() => state.frame.generated?.mode === "beside", "images beside the simulation");
  mode("off");
  await until(() => state.frame.generated === null && label() === "no image yet", "no more images");
  choose("maps", "color");
  choose("modes", "look");
  await until(() => !simulating(), "the log after generated images");
  return ", images generated";
}

function fits() {
  const root = document.documentElement;
  expect(root.scrollWidth <= root.clientWidth, `nothing sticks out to the right: ${root.scrollWidth} of ${root.clientWidth} px`);
}

function labelled() {
  for (const node of document.querySelectorAll("button, input, select, [role=slider], a")) {
    const name = node.getAttribute("aria-label") ?? node.closest("label")?.textContent ?? node.textContent;
    expect(name.trim() !== "", `a control without a name: ${node.outerHTML.slice(0, 80)}`);
  }
}

/** Mean brightness of a canvas, 0 for an empty one. */
function brightness(canvas) {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let sum = 0;
  for (let i = 0; i < data.length; i += 16) sum += data[i] + data[i + 1] + data[i + 2];
  return sum / (data.length / 16) / 3;
}

const quantile = (values, q) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(q * values.length))];

export async function selfTest(size = null) {
  await until(() => state.frame, "the first picture", 300000);
  const firstMs = Math.round(performance.now());
  const { cameras, maps, frames_us: frames, drivers } = state.hello;
  expect(cameras.length > 0 && maps.length > 0 && byId("maps").children.length === maps.length, "cameras, and a button per map");
  expect(document.querySelectorAll(".cell").length === cameras.length, "a cell per camera");
  if (!state.youDrive) { byId("take").click(); await until(() => state.youDrive, "this page drives"); }
  if (size) {
    patience = 6;
    send("view", { size });
    await until(() => state.frame.images?.[0]?.height === size[0], "maps of the wanted size");
  }
  if (simulating()) { choose("modes", "look"); await until(() => !simulating(), "looking at the log"); }
  await until(() => (state.frame.images ?? []).some(({ map }) => map === "birdseye"), "the bird's-eye view");
  labelled();
  fits();
  document.querySelector("#pose button").click();
  await until(() => Object.values(state.frame.offset).every((value) => Math.abs(value) < 0.01), "the recorded pose");

  choose("speeds", 1);
  await until(() => state.frame.speed === 1, "real time");

  // Maps by buttons, in all cameras; then in one.
  const shows = (camera, map) => canvasOf(camera).dataset.map === map && canvasOf(camera).width > 1;
  let pictures = 0;
  for (const map of maps.filter((map) => map !== "generated")) {
    choose("maps", map);
    await until(() => cameras.every(({ name }) => shows(name, map)), `map ${map} in all cameras`);
    expect(pressed("maps", map), `button ${map} is pressed`);
    pictures += cameras.length;
  }
  press("Digit1");
  const one = cameras[0].name, other = maps[1] ?? maps[0];
  await until(() => cameras.every(({ name }) => shows(name, maps[0])), "key 1 shows the first map");
  setValue(document.querySelector(".cell select"), other);
  await until(() => shows(one, other), "a map of one camera");
  expect(cameras.length < 2 || mapOf(cameras[1].name) === maps[0], "the other cameras keep their map");
  press("Digit1");
  await until(() => cameras.every(({ name }) => shows(name, maps[0])), "all cameras again");
  expect(cameras.some(({ name }) => brightness(canvasOf(name)) > 1), "pictures are not black");

  // Layers.
  for (const layer of ["beside", "blend", "swipe"]) {
    choose("layers", layer);
    await until(() => mapsOf(one).includes(layout.second) && document.querySelectorAll(".cell.paired").length > 0, `layer ${layer}`);
    const second = document.querySelector(".cell.paired .second");
    await until(() => second.dataset.map === layout.second, `second picture, ${layer}`);
    expect(getComputedStyle(second).display !== "none", `the second picture is visible, ${layer}`);
  }
  const handle = document.querySelector(".cell.paired .handle");
  const [hx, hy] = middle(handle);
  const before = layout.swipe;
  handle.setPointerCapture = () => {};
  await drag(handle, [hx, hy], [hx - 40, hy]);
  expect(layout.swipe < before, "the handle moves");
  choose("layers", "alone");
  await until(() => mapsOf(one).length === 1, "one map again");

  // Enlarge.
  const canvas = canvasOf(one);
  pointer(canvas, "dblclick", ...middle(canvas));
  expect(document.querySelectorAll(".cell:not([hidden])").length === 1, "a double click enlarges a camera");
  fits();
  press("Escape");
  expect(document.querySelectorAll(".cell:not([hidden])").length === cameras.length, "escape shows all cameras");

  // Time.
  const slider = byId("slider");
  for (const share of [0.5, 1, 0]) {
    setSlider(slider, share * Number(slider.max));
    const want = frames[0] + Number(slider.value);
    await until(() => Math.abs(state.frame.t_us - want) < 150000, `scrubbing to ${share}`);
  }
  press(".");
  if (frames.length > 1) await until(() => state.frame.t_us >= frames[1] - 1000, "a step to the next frame");
  press(",");
  await until(() => state.frame.t_us < frames[0] + 1000, "a step back");
  byId("play").click();
  await until(() => state.frame.t_us > frames[0] + 1000, "the log plays");
  if (state.frame.playing) byId("play").click();
  await until(() => !state.frame.playing, "the log pauses");
  setSlider(slider, 0);
  await until(() => state.frame.t_us < frames[0] + 1000, "back to the beginning");

  // Ego and cameras.
  const above = byId("birdseye-actors");
  above.setPointerCapture = () => {};
  const center = middle(above);
  await drag(above, center, [center[0] - 20, center[1] - 30]);
  await until(() => state.frame.offset.left_m > 0.5 && state.frame.offset.forward_m > 0.5, "dragging moves the ego");
  above.dispatchEvent(new WheelEvent("wheel", { deltaY: -100, bubbles: true, cancelable: true }));
  await until(() => state.frame.offset.yaw_deg > 0.5, "the wheel turns the ego");
  for (const [name, value] of [["forward_m", 2], ["left_m", -1], ["yaw_deg", 5], ["up_m", 1], ["pitch_deg", -3]]) {
    setSlider(byId(`slider-${name}`), value);
    await until(() => Math.abs(state.frame.offset[name] - value) < 0.01, `slider ${name}`);
  }
  [...document.querySelectorAll("#pose button")][0].click();
  await until(() => Object.values(state.frame.offset).every((value) => Math.abs(value) < 0.01), "the recorded pose");

  // Picking and hiding.
  let picked = null;
  on("picked", (message) => { picked = message; });
  const wanted = async (camera, right, down) => {
    picked = null;
    pointer(canvasOf(camera), "click", ...middle(canvasOf(camera), right, down));
    await until(() => picked, "a picked pixel");
  };
  search: for (const { name } of cameras) for (const right of [0.2, 0.35, 0.5, 0.65, 0.8]) for (const down of [0.6, 0.75]) {
    await wanted(name, right, down);
    if (picked.track) break search;
  }
  expect(byId("picked").children.length > 0 && document.querySelector(".marker:not([hidden])"), "the picked pixel is shown");
  let hidden = "no actor found to hide";
  const track = picked.track ?? state.frame.actors?.[0]?.track;
  if (track) {
    if (!picked.track) {
      const shape = above.querySelector(`[data-track="${CSS.escape(track)}"]`);
      pointer(shape, "pointerdown", ...middle(shape));
      pointer(shape, "pointerup", ...middle(shape));
    }
    await until(() => byId("hide"), "a button that hides the actor");
    byId("hide").click();
    await until(() => (state.view.hide ?? []).includes(track), "the actor is hidden");
    byId("hide").click();
    await until(() => !(state.view.hide ?? []).includes(track), "the actor is shown again");
    byId("hold").click();
    await until(() => track in (state.view.hold ?? {}), "the actor is held");
    await until(() => document.querySelectorAll("#edits li").length === 1, "the change is listed");
    document.querySelector("#edits button").click();
    await until(() => !(track in (state.view.hold ?? {})), "the change is undone");
    setValue(byId("replace"), "template");
    await until(() => state.view.replace?.[track] === "template", "the actor is a template");
    setValue(byId("replace"), "");
    await until(() => !document.getElementById("edits"), "no change is left");
    hidden = "an actor hidden, held and replaced";
  }

  // Drawing.
  const filter = [...document.querySelectorAll("#drawing select")].find((node) => [...node.options].some(({ value }) => value === "valid-area"));
  const kept = filter.value;
  setValue(filter, "valid-area");
  await until(() => state.view.color_filter === "valid-area", "the color filter");
  setValue(filter, kept);
  await until(() => state.view.color_filter === kept, "the color filter as before");
  expect(byId("command").textContent.startsWith("pskel "), "the command is shown");

  const made = state.hello.generator ? await generatedImages(cameras[0].name) : "";

  // Driving.
  choose("modes", "simulate");
  await until(() => simulating() && state.frame.playing, "a simulation runs");
  if (state.frame.speed !== 1) choose("speeds", 1);
  await until(() => state.frame.step >= 3, "steps of the log");
  const v0 = state.frame.ego.speed_mps;
  key("KeyW");
  await until(() => state.frame.by === "person", "a key takes the wheel");
  expect(byId("driver").textContent === "you drive" && !byId("driver").hidden, "the page shows who drives");
  expect(state.frame.takeover !== null, "the takeover is known");
  await until(() => state.frame.ego.speed_mps > v0 + 0.2, "the speed rises");
  const perSecond = async () => {
    received = 0;
    await sleep(FPS_MS);
    return received / (FPS_MS / 1000);
  };
  const fps = await perSecond();
  choose("speeds", 4);
  const most = await perSecond();
  choose("speeds", 1);
  const latencies = [];
  for (let i = 0; i < LATENCY_TRIALS; i++) {
    const code = i % 2 ? "KeyD" : "KeyA";
    const start = performance.now();
    key(code);
    const mine = keysNumber();
    const steer = state.frame.ego.steering_rad;
    // Servers that do not report the number of the controls: the first frame that steers to that side.
    const changed = (frame) => (frame.keys_number === undefined ? (frame.ego.steering_rad - steer) * (i % 2 ? -1 : 1) > 1e-4 : frame.keys_number >= mine);
    latencies.push((await frameWith(changed, "a picture after a key")) - start);
    key(code, "keyup");
    await sleep(40 + 30 * (i % 4));
    if (state.frame.ended) { byId("reset").click(); await until(() => !state.frame.ended, "a reset of what has ended"); }
  }
  key("KeyW", "keyup");
  key("Space");
  const fast = state.frame.ego.speed_mps;
  await until(() => state.frame.ego.speed_mps < Math.max(0.05, fast - 0.3), "space brakes");
  key("Space", "keyup");
  const policy = drivers.find((name) => name !== "log" && name !== "person");
  if (policy) {
    choose("drivers", policy);
    await until(() => state.frame.by === policy && byId("driver").textContent.includes(policy), "a policy drives");
  }
  press("KeyP");
  await until(() => !state.frame.playing, "a pause");
  expect(!byId("pill").hidden, "the pause is shown over the picture");
  const step = state.frame.step;
  press(".");
  await until(() => state.frame.step === step + 1, "a single step");
  const events = [];
  on("saved", (message) => events.push(message));
  byId("save").requestSubmit();
  await until(() => events.length, "the drive is saved", 60000);
  expect(byId("saved").textContent.includes(events[0].folder), "the folder of the saved drive is shown");
  expect(byId("cover").hidden, "the progress ends with the saving");
  await sleep(300);
  expect(document.querySelectorAll("#plots path").length >= 3 && [...document.querySelectorAll("#plots path")].every((path) => !path.getAttribute("d").includes("NaN")), "plots");
  press("KeyR");
  await until(() => state.frame.step < step, "a reset");
  cut();
  await until(() => !state.connected && !byId("cover").hidden && byId("cover-text").textContent.includes("No connection"), "a lost connection is shown");
  await until(() => state.connected && received > 0 && byId("cover").hidden, "it connects again");
  choose("modes", "look");
  await until(() => !simulating(), "the log again");
  fits();
  expect(!notices.length, `no errors of the server: ${notices.slice(0, 3).join("; ")}`);
  return `PASS: first picture after ${firstMs} ms, ${pictures} pictures, ${hidden}${made}, ${fps.toFixed(1)} fps in real time, ${most.toFixed(1)} at speed 4, key to picture median ${quantile(latencies, 0.5).toFixed(0)} ms, p99 ${quantile(latencies, 0.99).toFixed(0)} ms of ${latencies.length}`;
}

/** Leaves the page in a state, paused, with all pictures drawn. */
export async function show(name) {
  await until(() => state.frame, "the first picture", 300000);
  if (!state.youDrive) { byId("take").click(); await until(() => state.youDrive, "this page drives"); }
  const { cameras, frames_us: frames } = state.hello;
  document.querySelector("#pose button").click();
  if (state.frame.speed !== 1) choose("speeds", 1);
  if (name === "drive" || name === "generated") {
    if (!simulating()) choose("modes", "simulate");
    await until(simulating, "a simulation");
    byId("reset").click();
    await sleep(1000);
    if (!state.frame.playing) byId("play").click();
    await until(() => state.frame.playing, "a simulation that runs");
  } else if (simulating()) {
    choose("modes", "look");
    await until(() => !simulating(), "looking at the log");
  }
  if (name === "drive") {
    key("KeyW");
    await until(() => state.frame.by === "person" && state.frame.step >= 40, "two seconds of driving", 30000);
    key("KeyA");
    await sleep(400);
    for (const code of ["KeyA", "KeyW"]) key(code, "keyup");
  }
  if (name === "generated") {
    choose("maps", "generated");
    await until(() => document.querySelector(`[data-camera="${CSS.escape(cameras[0].name)}"] .origin`).textContent.startsWith("generated"), "generated images", 60000);
  } else {
    choose("maps", "color");
  }
  if (state.frame.playing) byId("play").click();
  await until(() => !state.frame.playing, "a pause");
  if (name === "look" || name === "picked") {
    const middle_us = frames[frames.length >> 1];
    setSlider(byId("slider"), middle_us - frames[0]);
    await until(() => Math.abs(state.frame.t_us - middle_us) <= 1000, "the middle of the log");
  }
  if (name === "picked") {
    await until(() => state.frame.actors?.length, "an actor");
    const shape = byId("birdseye-actors").querySelector(`[data-track="${CSS.escape(state.frame.actors[0].track)}"]`);
    for (const type of ["pointerdown", "pointerup"]) pointer(shape, type, ...middle(shape));
    await until(() => byId("hold"), "a picked actor");
    byId("hold").click();
    await until(() => document.getElementById("edits"), "a held actor");
  }
  await until(() => cameras.every(({ name }) => canvasOf(name).width > 1), "all pictures");
  await sleep(500);
  return SHOWN;
}

/** Does `count` random things; the page must then still show pictures, and no script may have failed. */
export async function randomTest(count, seed) {
  await until(() => state.frame, "the first picture", 300000);
  // A reload of the page goes on where it was.
  const kept = JSON.parse(sessionStorage.getItem("random") ?? "null") ?? { first: 0, s: seed >>> 0, cuts: 0, reloads: 0 };
  sessionStorage.removeItem("random");
  let { s, cuts, reloads } = kept;
  const random = () => { // mulberry32
    s = (s + 0x6d2b79f5) >>> 0;
    let t = Math.imul(s ^ (s >>> 15), s | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
  const one = (list) => list[Math.floor(random() * list.length)];
  const all = (selector) => [...document.querySelectorAll(selector)].filter((node) => !node.disabled && node.offsetParent !== null);
  const above = byId("birdseye-actors");
  above.setPointerCapture = () => {};
  const KEYS = ["KeyW", "KeyA", "KeyS", "KeyD", "ArrowUp", "ArrowLeft", "ArrowDown", "ArrowRight", "Space"];
  const somewhere = (node) => middle(node, 0.1 + 0.8 * random(), 0.1 + 0.8 * random());
  const moves = {
    key: () => key(one(KEYS), one(["keydown", "keyup"])),
    command: () => press(one(["KeyP", "KeyR", "KeyL", "KeyB", "KeyE", ".", ",", "Digit1", "Digit2", "Digit9", "Escape"])),
    button: () => one(all("#maps button, #layers button, #modes button, #speeds button, #drivers button, #tabs button, #timeline > button, .enlarge, #pose button, #picked button, #edits button, #take"))?.click(),
    slider: () => { const node = one(all("input[type=range]")); if (node) setSlider(node, Number(node.min) + random() * (node.max - node.min)); },
    list: () => { const node = one(all("select")); if (node) setValue(node, one([...node.options]).value); },
    check: () => one(all("#drawing input[type=checkbox]"))?.click(),
    pick: () => { const node = one(all(".cell canvas.first")); if (node) pointer(node, "click", ...somewhere(node)); },
    drag: () => drag(above, somewhere(above), somewhere(above), { shiftKey: random() < 0.3 }),
    wheel: () => above.dispatchEvent(new WheelEvent("wheel", { deltaY: random() - 0.5, bubbles: true, cancelable: true })),
    width: () => { document.body.style.width = one(["", "420px", "800px", "1280px"]); window.dispatchEvent(new Event("resize")); },
    cut: () => { if (random() < 0.2) { cuts++; cut(); } },
    reload: (next) => {
      if (random() > 0.1) return null;
      sessionStorage.setItem("random", JSON.stringify({ first: next, s, cuts, reloads: reloads + 1 }));
      location.reload();
      return new Promise(() => {});
    },
  };
  const names = Object.keys(moves);
  for (let i = kept.first; i < count; i++) {
    const name = one(names);
    try {
      await moves[name](i + 1);
    } catch (error) {
      throw new Error(`move ${i + 1} (${name}): ${error.message}`);
    }
    await sleep(random() < 0.1 ? 200 : 15);
    expect(!errors.length, `move ${i + 1} (${name}): ${errors[0]}`);
  }
  release();
  document.body.style.width = "";
  await until(() => state.connected, "connected after all moves", 20000);
  received = 0;
  press("Digit1");
  press("Digit2");
  if (simulating()) choose("modes", "look");
  await until(() => !simulating() && received > 0, "pictures after all moves", 20000);
  fits();
  return `PASS: ${count} random moves, seed ${seed}, ${cuts} cuts, ${reloads} reloads, ${notices.length} notices of errors${notices.length ? `: ${[...new Set(notices)].slice(0, 3).join("; ")}` : ""}`;
}
