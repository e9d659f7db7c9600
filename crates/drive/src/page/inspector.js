// What is known of a picked pixel or actor, and the changes of actors.

import { fixed, make } from "./plots.js";
import { openTab } from "./controls.js";
import { editButtons, editList, shortTrack } from "./edits.js";
import { emit, on, state } from "./store.js";
import { byId } from "./widgets.js";

const CLASSES = ["none", "vehicle", "pedestrian", "cycle", "object"];

export function startInspector() {
  const panel = byId("inspector");
  const body = panel.appendChild(make("div", { id: "picked", "aria-live": "polite" }));
  const edits = panel.appendChild(make("div"));
  body.append(make("p", { class: "facts" }, "Click a pixel of a camera, or an actor in the bird's-eye view."));
  let picked = null; // keeps the pixel's values while its own actor is selected
  const fill = () => {
    if (picked?.camera || picked?.track) body.replaceChildren();
    if (picked?.camera) body.append(pixelTable(picked));
    if (picked?.track) body.append(actorTable(picked.track, picked.actor), editButtons(picked.track));
    edits.replaceChildren(...editList());
  };
  const show = () => {
    fill();
    openTab("inspector");
  };
  on("picked", (message) => {
    picked = message;
    show();
    emit("select", message.track ?? null);
    emit("path", message.actor?.path ?? []);
  });
  on("select", (track) => {
    if (track === (picked?.track ?? null)) return;
    picked = { track };
    show();
  });
  on("view", fill);
}

function table(rows) {
  const list = make("dl", { class: "table numbers" });
  for (const [name, value] of rows) {
    if (value === null || value === undefined || value === "") continue;
    const row = make("div");
    row.append(make("dt", {}, name), make("dd", {}, String(value)));
    list.append(row);
  }
  return list;
}

const number = (value, digits, unit) => (typeof value === "number" ? `${fixed(value, digits)} ${unit}` : null);

function pixelTable({ camera, x, y, depth_m, class: name, point, rgb }) {
  const list = table([
    ["Pixel", `${camera} ${x}, ${y}`],
    ["Depth", number(depth_m, 2, "m") ?? "empty"],
    ["Class", CLASSES[name] ?? name],
    ["Point", Array.isArray(point) ? `${point.map((value) => fixed(Number(value), 2)).join("  ")} m` : null],
    ["Source sweep", "not kept in skeletons"],
    ["Color", Array.isArray(rgb) ? rgb.join(" ") : null],
  ]);
  if (Array.isArray(rgb)) {
    const swatch = make("i", { class: "color" });
    swatch.style.background = `rgb(${rgb.map(Number).join(" ")})`;
    list.lastElementChild.lastElementChild.append(" ", swatch);
  }
  return list;
}

function actorTable(track, actor) {
  const known = (state.hello?.tracks ?? []).find((entry) => entry.track === track);
  const shown = (state.frame?.actors ?? []).find((entry) => entry.track === track);
  const seconds = (t_us) => fixed((t_us - (state.hello?.frames_us?.[0] ?? 0)) / 1e6, 1);
  const size = actor?.size_m ?? (shown ? [shown.length, shown.width] : null);
  return table([
    ["Actor", actor?.category ?? known?.category],
    ["Track", shortTrack(track)],
    ["Asset", actor ? actor.asset ?? "none" : known?.points ? `${known.points} points` : "none"],
    ["Geometry of", typeof actor?.template === "boolean" ? (actor.template ? "a template" : "its own points") : null],
    ["Size", Array.isArray(size) ? `${size.map((value) => fixed(Number(value), 1)).join(" x ")} m` : null],
    ["Recorded speed", number(actor?.speed_mps, 1, "m/s")],
    ["From the ego", number(actor?.distance_m, 1, "m")],
    ["Boxes", actor?.boxes ?? known?.boxes],
    ["In the log", known ? `${seconds(known.first_us)} to ${seconds(known.last_us)} s` : null],
  ]);
}
