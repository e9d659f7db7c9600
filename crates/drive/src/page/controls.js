// The panel: pose of the ego and the cameras, simulation, and options of drawing.

import { make } from "./plots.js";
import { send, sendSoon } from "./connection.js";
import { emit, on, onCalm, simulating, state } from "./store.js";
import { button, byId, choice, field, select, setField, setText, slider } from "./widgets.js";

const TABS = [["pose", "Pose"], ["simulation", "Drive"], ["drawing", "Drawing"], ["inspector", "Picked"]];
const SIZES = ["128x224", "192x336", "256x448", "384x672", "512x896"];
const SPLATS = ["15:2,35:1,100:0", "5:4,15:2,35:1,100:0", "100:0", "100:1"];
const POSE = [
  { name: "forward_m", text: "Forward", unit: "m", min: -20, max: 20, step: 0.1 },
  { name: "left_m", text: "Left", unit: "m", min: -10, max: 10, step: 0.1 },
  { name: "yaw_deg", text: "Turned left", unit: "\u00b0", min: -180, max: 180, step: 0.5 },
];
const CAMERA = [
  { name: "up_m", text: "Camera up", unit: "m", min: -2, max: 5, step: 0.05, digits: 2 },
  { name: "pitch_deg", text: "Camera pitch", unit: "\u00b0", min: -45, max: 45, step: 0.5 },
];

export function startControls() {
  tabs();
  pose();
  simulation();
  drawing();
}

/** Shows one of the panels; on high screens all are visible. */
export function openTab(id) {
  for (const [name] of TABS) {
    byId(name).classList.toggle("open", name === id);
    byId(`tab-${name}`).setAttribute("aria-selected", name === id);
  }
}

function tabs() {
  for (const [id, text] of TABS) byId("tabs").append(button(text, () => openTab(id), { id: `tab-${id}`, role: "tab", "aria-controls": id }));
  openTab("pose");
}

function pose() {
  const panel = byId("pose");
  const offset = (name, value) => sendSoon("look", { [name]: value });
  // Both fields, as they replace each other in the message.
  const camera = (name, value) => {
    const { up_m = 0, pitch_deg = 0 } = state.frame?.offset ?? {};
    sendSoon("look", { camera: { up_m, pitch_deg, ...held, [name]: value } });
    held = { ...held, [name]: value };
  };
  let held = {};
  const sliders = [
    ...POSE.map((options) => [options.name, slider(panel, { ...options, action: (value) => offset(options.name, value) })]),
    ...CAMERA.map((options) => [options.name, slider(panel, { ...options, action: (value) => camera(options.name, value) })]),
  ];
  const recorded = panel.appendChild(button("Recorded pose", () => {
    held = {};
    send("look", { forward_m: 0, left_m: 0, yaw_deg: 0, camera: { up_m: 0, pitch_deg: 0 } });
  }));
  onCalm(({ header }) => {
    for (const [name, slider] of sliders) {
      const value = header.offset?.[name];
      if (typeof value === "number") slider.set(value);
      if (held[name] === value) delete held[name];
      slider.disable(simulating());
    }
    recorded.disabled = simulating();
    panel.title = simulating() ? "In a simulation the driver moves the ego; choose Log beside the time line to move it" : "";
  });
}

function simulation() {
  const panel = byId("simulation");
  field(panel, "Steps per second", make("input", { type: "number", min: 2, max: 100, step: 1, value: 20, id: "hz" }), () => {});
  const actors = field(panel, "Other actors", select([["idm", "reactive (IDM)"], ["replay", "as recorded"]], { id: "actors" }), () => {});
  panel.append(button("Simulate from here", () => simulate(), { id: "simulate" }));
  const save = panel.appendChild(make("form", { class: "bar", id: "save" }));
  const name = make("input", { type: "text", pattern: "[A-Za-z0-9_\\-]+", maxlength: 64, placeholder: "name, optional", "aria-label": "Name of the saved drive" });
  const saveButton = make("button", { type: "submit" }, "Save as rollout");
  save.append(name, saveButton);
  save.addEventListener("submit", (event) => {
    event.preventDefault();
    send("save", name.value ? { name: name.value } : {});
    name.blur();
    saveButton.blur();
  });
  const saved = panel.appendChild(make("p", { class: "hint", id: "saved", role: "status" }));
  let group = null;
  on("hello", (hello) => {
    group = choice(byId("drivers"), (hello.drivers ?? []).map((name) => [name, name.replaceAll("_", " "), name === "log" ? "key L" : name === "person" ? "a key of driving takes the wheel" : "policy"]), (by) => {
      if (!simulating()) simulate();
      handOver(by);
    });
  });
  onCalm(({ header }) => {
    group?.set(simulating() ? header.by : null);
    saveButton.disabled = !simulating();
  });
  on("saved", (message) => {
    const page = typeof message.page === "string" && message.page.startsWith("/") && !message.page.startsWith("//") ? message.page : null;
    saved.replaceChildren(`Saved in ${message.folder}. `);
    const mcap = message.mcap ? `/rollouts/${message.name}.mcap` : null;
    for (const [path, text] of [[page, "Its page"], [message.video, "video"], [mcap, "MCAP"]]) {
      if (path) saved.append(make("a", { href: path, target: "_blank", rel: "noopener" }, text), " ");
    }
    if (message.command) saved.append(make("code", {}, message.command));
    openTab("simulation");
  });
}

/** Hands the wheel to the log, a person or a policy. */
export function handOver(by) {
  emit("handover");
  send("control", { by });
}

/** Begins a simulation at the time shown, with the options of the panel. */
export function simulate() {
  if (!state.frame) return;
  const hz = Number(byId("hz").value);
  send("simulate", { ...(hz > 0 ? { hz } : {}), actors: byId("actors").value, from_t_us: state.frame.t_us });
  send("play", { playing: true });
}

function drawing() {
  const panel = byId("drawing");
  const view = (fields) => send("view", fields);
  const number = (name, { value }) => { if (value !== "" && Number.isFinite(Number(value))) view({ [name]: Number(value) }); };
  const text = (options) => make("input", { type: "text", spellcheck: "false", ...options });
  const list = make("datalist", { id: "splats" });
  list.append(...SPLATS.map((value) => make("option", { value })));
  panel.append(list);
  const fields = {
    size: field(panel, "Size", select(SIZES.map((size) => [size, size])), ({ value }) => view({ size: value.split("x").map(Number) })),
    splat: field(panel, "Splat (m:px)", text({ list: "splats", title: "Radius of a point in pixels, by depth in meters" }), ({ value }) => view({ splat: value })),
    radius_m: field(panel, "Radius (m)", make("input", { type: "number", min: 5, max: 300, step: 5 }), (node) => number("radius_m", node)),
    reduce: field(panel, "Reduced", make("input", { type: "checkbox", title: "Renders at the size of the cameras and reduces, as for training; slower. The color filter is for this" }), ({ checked }) => view({ reduce: checked })),
    color_filter: field(panel, "Color filter", select(["bilinear", "valid-area", "visible-area"].map((name) => [name, name])), ({ value }) => view({ color_filter: value })),
    occlusion: field(panel, "Actors hidden by", select([["scene", "the whole scene"], ["actors", "other actors"]]), ({ value }) => view({ occlusion: value })),
    min_actor_points: field(panel, "Own points above", make("input", { type: "number", min: 0, step: 50, title: "Actors with at most this many points use their template" }), (node) => number("min_actor_points", node)),
    template_fit: field(panel, "Fit of templates", select([["box", "scaled to the box"], ["none", "own size"]]), ({ value }) => view({ template_fit: value })),
    default_templates: field(panel, "Default templates", make("input", { type: "checkbox" }), ({ checked }) => view({ default_templates: checked })),
    augment: field(panel, "Augmentation", text({ placeholder: "none; or 0,share=0.8", title: "As --augment: seed, share=S, color_only. Empty: none" }), ({ value }) => view({ augment: value.trim() || null })),
    codec: field(panel, "Pictures sent as", select([["jpeg", "JPEG"], ["png", "PNG, lossless"]]), ({ value }) => view({ codec: value })),
  };
  const hidden = panel.appendChild(make("div", { class: "bar", id: "hidden-actors" }));
  on("view", (view) => {
    for (const [name, node] of Object.entries(fields)) setField(node, name === "size" ? (view.size ?? []).join("x") : view[name]);
    const tracks = view.hide ?? [];
    setText(hidden, tracks.length ? `${tracks.length} hidden: ` : "");
    if (tracks.length) hidden.append(button("Show all", () => send("view", { hide: [] })));
  });
}
