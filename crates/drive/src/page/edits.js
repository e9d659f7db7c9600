// Changes of actors: hidden, held where they are, or replaced by others; each can be undone.

import { fixed, make } from "./plots.js";
import { send } from "./connection.js";
import { state } from "./store.js";
import { button, field, select, setField } from "./widgets.js";

/** The end of a long track id, which tells it apart. */
export const shortTrack = (track) => (track.length > 16 ? `\u2026${track.slice(-12)}` : track);

const known = () => state.hello?.tracks ?? [];
const hidden = () => state.view.hide ?? [];
const held = () => state.view.hold ?? {};
const replaced = () => state.view.replace ?? {};

const without = (edits, track) => Object.fromEntries(Object.entries(edits).filter(([other]) => other !== track));

const seconds = (t_us) => fixed((t_us - (state.hello?.frames_us?.[0] ?? 0)) / 1e6, 1);

const hide = (track) => send("view", { hide: [...hidden(), track] });
const show = (track) => send("view", { hide: hidden().filter((other) => other !== track) });
const hold = (track) => send("view", { hold: { ...held(), [track]: state.frame.t_us } });
const release = (track) => send("view", { hold: without(held(), track) });
const replace = (track, by) => send("view", { replace: by ? { ...replaced(), [track]: by } : without(replaced(), track) });

/** Buttons that change a picked actor. */
export function editButtons(track) {
  const box = make("div", { class: "edits" });
  const row = box.appendChild(make("div", { class: "bar" }));
  row.append(hidden().includes(track) ? button("Show", () => show(track), { id: "hide" }) : button("Hide", () => hide(track), { id: "hide" }));
  row.append(track in held()
    ? button("Let it move", () => release(track), { id: "hold" })
    : button("Hold here", () => hold(track), { id: "hold", title: "Stands in all frames where it is in the log now" }));
  const by = select([["", "itself"], ["template", "a template"], ...others(track)], { id: "replace" });
  setField(by, replaced()[track] ?? "");
  field(box, "Looks like", by, (node) => replace(track, node.value));
  return box;
}

// Other actors with points, the best observed of each category first.
function others(track) {
  const seen = known().filter((other) => other.points > 0 && other.track !== track);
  seen.sort((a, b) => a.category.localeCompare(b.category) || b.points - a.points || a.track.localeCompare(b.track));
  return seen.map((other) => [other.track, `${other.category} ${shortTrack(other.track)}`]);
}

/** Lists all changes, each with a button that undoes it. */
export function editList() {
  const category = (track) => known().find((other) => other.track === track)?.category ?? "";
  const entries = [
    ...hidden().map((track) => [track, "hidden", () => show(track)]),
    ...Object.entries(held()).map(([track, t_us]) => [track, `held at ${seconds(t_us)} s`, () => release(track)]),
    ...Object.entries(replaced()).map(([track, by]) => [track, by === "template" ? "a template" : `like ${shortTrack(by)}`, () => replace(track, "")]),
  ];
  if (!entries.length) return [];
  const list = make("ul", { id: "edits" });
  for (const [track, text, undo] of entries) {
    const item = list.appendChild(make("li"));
    const name = make("span", { class: "name", title: track }, `${category(track)} ${shortTrack(track)}`);
    item.append(name, make("span", { class: "facts" }, text));
    item.append(button("Undo", undo, { "aria-label": `Undo: ${text}, ${track}` }));
  }
  return [make("h2", {}, "Changed actors"), list];
}
