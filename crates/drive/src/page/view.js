// The cameras: one map each, alone or with a second picture beside, blended, or behind a handle.

import { fixed, make } from "./plots.js";
import { address, send } from "./connection.js";
import { generate, generatedOrigin, generatorMode } from "./generator.js";
import { emit, on, onCalm, state } from "./store.js";
import { notice } from "./status.js";
import { button, byId, choice, fill, select, setText } from "./widgets.js";

const LAYERS = [["alone", "alone"], ["beside", "beside"], ["blend", "blend"], ["swipe", "swipe"]];
const CLASSES = [["#5095ff", "vehicle"], ["#ff5555", "pedestrian"], ["#50d278", "cycle"], ["#ffc850", "object"]];

/** What the page itself chooses: the layer, the second map, the enlarged camera, share and place of the handle. */
export const layout = { layer: "alone", second: "recorded", camera: null, blend: 0.5, swipe: 0.5 };

const cells = new Map();
let mapChoice = null;
let layerChoice = null;

/** The names of the maps drawn for a camera. */
export function mapsOf(camera) {
  const { maps = [], cameras = {} } = state.view;
  return cameras[camera] ?? (Array.isArray(maps) ? maps : maps[camera] ?? []);
}

/** The map of a camera that is shown first. */
export function mapOf(camera) {
  const maps = mapsOf(camera);
  return (layout.layer === "alone" ? maps[0] : maps.find((map) => map !== layout.second)) ?? maps[0] ?? null;
}

/** Words for the origin of a picture, and its kind: drawn, recorded or generated. */
function origin(map) {
  if (map === "recorded") return ["recorded", "recorded"];
  return map === "generated" ? generatedOrigin() : ["drawn", "drawn"];
}

export function startView() {
  layerChoice = choice(byId("layers"), LAYERS, setLayer);
  byId("with").addEventListener("change", () => {
    layout.second = byId("with").value;
    byId("with").blur();
    setLayer(layout.layer);
  });
  byId("blend").addEventListener("input", () => { layout.blend = Number(byId("blend").value); arrange(); });
  byId("blend").addEventListener("pointerup", () => byId("blend").blur());
  for (const [color, name] of CLASSES) {
    const entry = make("span");
    const swatch = make("i");
    swatch.style.background = color;
    entry.append(swatch, name);
    byId("classes").append(entry);
  }
  on("hello", build);
  on("view", () => { labels(); arrange(); });
  on("frame", draw);
  onCalm(numbers);
  on("picked", mark);
  labels();
  window.addEventListener("resize", arrange);
  arrange();
}

function build({ cameras = [], maps = [] }) {
  mapChoice = choice(byId("maps"), maps.map((map, i) => [map, map, `key ${i + 1}`]), (map) => setMap(map));
  if (!maps.includes(layout.second)) layout.second = maps.includes("recorded") ? "recorded" : maps[0];
  fill(byId("with"), maps.map((map) => [map, map]));
  byId("with").value = layout.second;
  if (!cameras.some(({ name }) => name === layout.camera)) layout.camera = null;
  cells.clear();
  byId("grid").replaceChildren(...cameras.map((camera) => cell(camera, maps)));
}

const shortName = (name) => name.replace(/^CAM_/, "").replaceAll("_", " ").toLowerCase();

function cell({ name }, maps) {
  const node = make("figure", { class: "cell", "data-camera": name });
  const pictures = [0, 1].map((i) => make("canvas", { class: i ? "second" : "first", role: "img", "aria-label": `Camera ${shortName(name)}` }));
  const marker = make("span", { class: "marker", hidden: "" });
  const handle = make("span", { class: "handle", role: "slider", tabindex: 0, "aria-label": "Border between the two pictures", "aria-valuemin": 0, "aria-valuemax": 100 });
  const map = select(maps.map((map) => [map, map]), { "aria-label": `Map of camera ${shortName(name)}` });
  const [from, second, psnr] = [make("span", { class: "origin" }), make("span", { class: "origin" }), make("span", { class: "psnr numbers", title: "PSNR of the color map against the recorded image" })];
  const scale = make("span", { class: "scale numbers", hidden: "" });
  const [near, far] = [make("span", {}, "0 m"), make("span")];
  scale.append(near, make("i"), far);
  const png = make("a", { target: "_blank", rel: "noopener", title: "This map at the size of the recorded camera, as PNG" }, "PNG");
  const enlarge = button("\u2922", () => setCamera(layout.camera === name ? null : name), { "aria-label": `Enlarge camera ${shortName(name)}`, "aria-pressed": false, class: "enlarge" });
  const caption = make("figcaption");
  caption.append(make("b", {}, shortName(name)), map, from, second, png, enlarge);
  node.append(...pictures, marker, handle, scale, psnr, caption);
  map.addEventListener("change", () => { setMap(map.value, name); map.blur(); });
  pictures.forEach((canvas, i) => {
    canvas.addEventListener("click", (event) => pick(name, i, event));
    canvas.addEventListener("dblclick", () => setCamera(layout.camera === name ? null : name));
  });
  const swipe = (event) => {
    const box = node.getBoundingClientRect();
    setSwipe((event.clientX - box.left) / box.width);
  };
  handle.addEventListener("pointerdown", (event) => { handle.setPointerCapture(event.pointerId); swipe(event); });
  handle.addEventListener("pointermove", (event) => { if (event.buttons) swipe(event); });
  handle.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
    if (step) { setSwipe(layout.swipe + step); event.preventDefault(); event.stopPropagation(); }
  });
  cells.set(name, { node, pictures, marker, handle, map, from, second, psnr, scale, far, png, enlarge, mark: null });
  return node;
}

/** Shows a map, in all cameras or in one. */
export function setMap(map, camera = null) {
  const first = Object.fromEntries([...cells.keys()].map((name) => [name, camera === null || camera === name ? map : mapOf(name)]));
  requestMaps(first);
}

export function setLayer(layer) {
  const first = Object.fromEntries([...cells.keys()].map((name) => [name, mapOf(name)]));
  layout.layer = layer;
  requestMaps(first);
  labels();
  arrange();
}

/** The next of the layers. */
export function nextLayer() {
  setLayer(LAYERS[(LAYERS.findIndex(([layer]) => layer === layout.layer) + 1) % LAYERS.length][0]);
}

export function setCamera(camera) {
  layout.camera = camera;
  arrange();
}

function setSwipe(value) {
  layout.swipe = Math.max(0, Math.min(1, value));
  arrange();
}

// Per camera the first map and, where there is a second layer, that one.
function requestMaps(first) {
  const lists = Object.entries(first).map(([name, map]) => [name, layout.layer === "alone" ? [map] : [...new Set([map, layout.second])]]);
  if (!lists.length || lists.some(([, [map]]) => !map)) return;
  const same = lists.every(([, list]) => list.join() === lists[0][1].join());
  send("view", { maps: same ? lists[0][1] : Object.fromEntries(lists) });
  if (lists.some(([, list]) => list.includes("generated")) && generatorMode() === "off") {
    generate("lockstep");
    notice("The simulation waits for generated images (lockstep). The panel Drive has the choice.");
  }
}

function secondOf(camera) {
  if (layout.layer === "alone") return null;
  const second = mapsOf(camera).find((map) => map !== mapOf(camera));
  return second ?? null;
}

function labels() {
  const maps = [...cells.keys()].map(mapOf);
  mapChoice?.set(maps.every((map) => map === maps[0]) ? maps[0] : null);
  layerChoice.set(layout.layer);
  byId("classes").hidden = !maps.includes("class");
  byId("blend-label").hidden = layout.layer !== "blend";
  byId("with-label").hidden = layout.layer === "alone";
  const far = `${state.view.radius_m ?? 100} m`;
  for (const [name, cell] of cells) {
    const map = mapOf(name), second = secondOf(name);
    if (map && document.activeElement !== cell.map) cell.map.value = map;
    origins(cell, map, second);
    cell.node.classList.toggle("paired", Boolean(second));
    cell.scale.hidden = map !== "depth" && second !== "depth";
    setText(cell.far, far);
    if (map) cell.png.href = address("/picture", { camera: name, map });
    cell.png.hidden = map === "recorded";
    cell.pictures[0].setAttribute("aria-label", `Camera ${shortName(name)}: ${map}`);
    cell.pictures[1].setAttribute("aria-label", `Camera ${shortName(name)}: ${second}`);
  }
}

function origins(cell, map, second) {
  const [text, kind] = map ? origin(map) : ["", ""];
  setText(cell.from, text);
  cell.from.dataset.origin = kind;
  const [secondText, secondKind] = second ? origin(second) : ["", ""];
  setText(cell.second, secondText === "drawn" ? `${second} drawn` : secondText);
  cell.second.dataset.origin = secondKind;
}

function arrange() {
  const grid = byId("grid");
  grid.dataset.layer = layout.layer;
  grid.style.setProperty("--blend", layout.blend);
  grid.style.setProperty("--swipe", `${100 * layout.swipe}%`);
  const columns = layout.camera !== null ? 1 : cells.size > 6 ? 4 : 3;
  grid.style.setProperty("--columns", columns);
  const large = !cells.size || layout.camera !== null || layout.layer === "beside";
  grid.style.flexBasis = large ? "200vh" : `${wantedHeight(columns)}px`;
  grid.style.setProperty("--aspect", String(aspect()));
  grid.classList.toggle("single", layout.camera !== null);
  for (const [name, cell] of cells) cell.node.hidden = layout.camera !== null && layout.camera !== name;
  grid.classList.toggle("stacked", layout.layer === "beside" && stacks());
  for (const [name, cell] of cells) {
    cell.enlarge.setAttribute("aria-pressed", layout.camera === name);
    cell.handle.setAttribute("aria-valuenow", Math.round(100 * layout.swipe));
    place(cell);
  }
}

function draw({ header, images }) {
  for (const { camera, map, width, height, bitmap } of images) {
    const cell = cells.get(camera);
    if (!cell || !bitmap) continue;
    const slot = map === mapOf(camera) ? 0 : map === secondOf(camera) ? 1 : -1;
    if (slot < 0) continue;
    const canvas = cell.pictures[slot];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    canvas.getContext("2d", { alpha: false }).drawImage(bitmap, 0, 0);
    if (canvas.dataset.map !== map) canvas.dataset.map = map;
  }
  // Without an image the cell must not keep another.
  for (const [name, cell] of cells) {
    for (const [canvas, map] of [[cell.pictures[0], mapOf(name)], [cell.pictures[1], secondOf(name)]]) {
      if (map === "generated" && !images.some((image) => image.camera === name && image.map === map)) clear(canvas);
    }
  }
  for (const cell of cells.values()) if (cell.mark && header.t_us !== cell.mark.t_us) { cell.mark = null; place(cell); }
}

function clear(canvas) {
  if (!canvas.dataset.map) return;
  canvas.getContext("2d", { alpha: false }).fillRect(0, 0, canvas.width, canvas.height);
  canvas.dataset.map = "";
}

function numbers({ header }) {
  const all = Array.isArray(header.psnr_db) ? Object.fromEntries(header.psnr_db) : header.psnr_db;
  for (const [name, cell] of cells) {
    const psnr = all?.[name], map = mapOf(name), second = secondOf(name);
    if (map === "generated" || second === "generated") origins(cell, map, second);
    setText(cell.psnr, typeof psnr === "number" && map === "color" ? `${fixed(psnr, 1)} dB` : "");
  }
}

/** Height of the caption above an image, pixels. */
const CAPTION_PX = 22;
const GAP_PX = 4;

/** Width of the images by their height. */
function aspect() {
  const [height, width] = state.view.size ?? [9, 16];
  return width / height;
}

// Whether two images in a cell are larger one above the other than side by side.
function stacks() {
  const cell = [...cells.values()].find(({ node }) => !node.hidden)?.node;
  if (!cell) return false;
  const [width, height] = [cell.clientWidth, cell.clientHeight - CAPTION_PX];
  return Math.min(width, height / 2 * aspect()) > Math.min(width / 2, height * aspect());
}

// Height at which the images fill the width; the plots take what remains.
function wantedHeight(columns) {
  const width = (byId("grid").clientWidth - GAP_PX * (columns - 1)) / columns;
  const rows = Math.ceil(cells.size / columns);
  return Math.ceil(rows * (width / aspect() + CAPTION_PX) + GAP_PX * (rows - 1));
}

// The place of an image in its element, in pixels of the window: at the bottom, centered in width.
function placed(canvas) {
  const box = canvas.getBoundingClientRect();
  const scale = Math.min(box.width / canvas.width, box.height / canvas.height);
  return { left: box.left + (box.width - scale * canvas.width) / 2, top: box.bottom - scale * canvas.height, scale };
}

/** The pixel of the image below a pointer, or null outside. */
function pixel(canvas, event) {
  const { left, top, scale } = placed(canvas);
  const x = Math.floor((event.clientX - left) / scale);
  const y = Math.floor((event.clientY - top) / scale);
  return x >= 0 && y >= 0 && x < canvas.width && y < canvas.height ? { x, y } : null;
}

function pick(camera, slot, event) {
  const canvas = cells.get(camera).pictures[slot];
  const at = pixel(canvas, event);
  const map = canvas.dataset.map;
  if (at && map && send("pick", { camera, map, ...at })) emit("picking", { camera, map, ...at });
}

function mark({ camera, x, y }) {
  for (const [name, cell] of cells) {
    cell.mark = name === camera && typeof x === "number" ? { x, y, t_us: state.frame?.t_us } : null;
    place(cell);
  }
}

// The marker of the picked pixel.
function place({ node, pictures: [canvas], marker, mark }) {
  marker.hidden = !mark || node.hidden;
  if (marker.hidden) return;
  const outer = node.getBoundingClientRect();
  const { left, top, scale } = placed(canvas);
  marker.style.left = `${left - outer.left + scale * (mark.x + 0.5)}px`;
  marker.style.top = `${top - outer.top + scale * (mark.y + 0.5)}px`;
}

/** The canvas with the first picture of a camera. */
export const canvasOf = (camera) => cells.get(camera)?.pictures[0] ?? null;
