// Generated images: whether they are made, what they are, and how far behind.

import { fixed, make } from "./plots.js";
import { send } from "./connection.js";
import { on, onCalm, simulating, state } from "./store.js";
import { byId, choice, setText } from "./widgets.js";

const MODES = [
  ["off", "off"],
  ["lockstep", "lockstep", "The simulation waits for each image"],
  ["beside", "beside", "The simulation goes on, images appear when they are finished"],
];
/** Delay that is told, seconds. */
const BEHIND_S = 0.05;

let mode = "off";

/** Whether images are generated: `off`, `lockstep` or `beside`. */
export const generatorMode = () => mode;

export function startGenerator() {
  const row = make("div", { class: "row", id: "generator", hidden: "" });
  row.append(make("span", {}, "Generated"));
  const bar = row.appendChild(make("span", { class: "bar", role: "group", "aria-label": "Generated images" }));
  const facts = make("p", { class: "hint numbers", id: "generator-facts", hidden: "" });
  byId("simulation").append(row, facts);
  let group = null;
  on("hello", ({ generator }) => {
    mode = generator?.mode ?? "off";
    row.hidden = facts.hidden = !generator;
    group = choice(bar, MODES, generate);
    group.set(mode);
  });
  onCalm(({ header }) => {
    if (!state.hello?.generator) return;
    if (simulating()) mode = header.generated?.mode ?? "off";
    group.set(mode);
    setText(facts, text(header.generated));
  });
}

/** Begins to generate, or ends it. Generated images exist in simulations only. */
export function generate(wanted) {
  mode = wanted;
  send("generate", { mode });
  if (mode !== "off" && !simulating() && state.frame) send("simulate", { from_t_us: state.frame.t_us });
}

function text(generated) {
  const { name, hz, references } = state.hello.generator;
  const about = `${name}, ${fixed(hz, 1)} a second`;
  if (!generated) return mode === "off" ? about : `${about}: begins with a simulation`;
  if (generated.failure) return `${about}. Failed: ${generated.failure}`;
  if (generated.references < references) return `${about}. The log drives: reference ${generated.references} of ${references}`;
  const each = typeof generated.network_s === "number" ? `, ${fixed(generated.network_s, 2)} s each` : "";
  const waits = generated.is_waiting ? ", the simulation waits" : "";
  return `${about}. ${generated.count} generated${each}, ${generated.skipped} skipped${waits}`;
}

/** Words for generated images of a frame, and what they are: `generated`, `recorded` or nothing. */
export function generatedOrigin() {
  const generated = simulating() ? state.frame?.generated : null;
  if (!generated || generated.step === null) return ["no image yet", ""];
  const late = generated.behind_s >= BEHIND_S ? `, ${fixed(generated.behind_s, 1)} s behind` : "";
  return generated.is_reference ? [`reference, recorded${late}`, "recorded"] : [`generated${late}`, "generated"];
}
