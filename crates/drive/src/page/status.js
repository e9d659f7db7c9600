// The line at the top, the text over the picture, notices, and the command.

import { fixed } from "./plots.js";
import { send } from "./connection.js";
import { driverText, on, onCalm, simulating, state } from "./store.js";
import { byId, setText } from "./widgets.js";

const cover = { lost: null, progress: null, refused: null };
const shown = []; // times of the frames of the last second, ms
let dropped = 0;
let pageMs = null; // time to decode and to draw a frame here, smoothed
let noticeTimer = null;

export function startStatus() {
  on("hello", ({ log, description }) => {
    cover.lost = null;
    cover.progress = null;
    document.title = `${log}: drive`;
    byId("log").textContent = log;
    setText(byId("description"), description ?? "");
    showCover();
  });
  on("lost", ({ attempts }) => {
    cover.lost = attempts;
    setText(byId("mode"), "not connected");
    showCover();
  });
  on("refused", ({ protocol }) => {
    cover.refused = `This page and the server are of different versions (protocol ${protocol}). Reload the page.`;
    showCover();
  });
  on("progress", (message) => {
    cover.lost = null;
    cover.progress = message;
    showCover();
  });
  on("frame", () => {
    const now = performance.now();
    shown.push(now);
    while (shown[0] < now - 1000) shown.shift();
    if (cover.progress || !byId("cover").hidden) endProgress();
  });
  onCalm(({ header }) => {
    showState(header);
    showStats(header);
  });
  on("drawn", ({ ms }) => { pageMs = pageMs === null ? ms : 0.9 * pageMs + 0.1 * ms; });
  on("who", () => { if (state.frame) showState(state.frame); });
  on("counts", (counts) => { dropped = counts.dropped ?? 0; });
  on("saved", endProgress);
  on("notice", ({ text, level }) => {
    notice(text, level);
    if (cover.progress && state.frame) endProgress(); // a drive could not be saved
  });
  byId("take").addEventListener("click", () => send("drive", { take: true }));
  byId("copy").addEventListener("click", copyCommand);
  showCover();
}

function endProgress() {
  cover.progress = null;
  showCover();
}

/** Shows a text for some seconds. */
export function notice(text, level = "info") {
  const node = byId("notice");
  node.textContent = text;
  node.classList.toggle("alert", level === "error");
  node.hidden = false;
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => { node.hidden = true; }, 6000);
}

function showCover() {
  // Without a connection nothing can be set.
  document.body.classList.toggle("offline", !state.connected);
  for (const node of document.querySelectorAll(".tools, aside, #timeline")) node.inert = !state.connected;
  const { lost, progress, refused } = cover;
  let text = "";
  if (refused) text = refused;
  else if (lost !== null) text = `No connection to the server. Reconnecting (attempt ${lost}).`;
  else if (progress) text = progress.of ? `${progress.what}: ${progress.done} of ${progress.of}` : `${progress.what}`;
  else if (!state.frame) text = state.connected ? "Waiting for the first picture." : "Connecting to the server.";
  setText(byId("cover-text"), text);
  const bar = byId("cover-progress");
  bar.hidden = Boolean(lost !== null || refused || !progress?.of);
  if (!bar.hidden) bar.value = progress.done / progress.of;
  byId("cover").hidden = !text;
  byId("cover").classList.toggle("solid", !state.frame);
}

function showState(header) {
  const look = !simulating();
  setText(byId("mode"), look ? "log" : header.ended ? "simulation ended" : header.playing ? "simulation" : "simulation paused");
  const driver = byId("driver");
  driver.hidden = false;
  const who = driverText(look ? "log" : header.by);
  setText(driver, state.youDrive || (!look && header.by === "person") ? who : `${who}, another client has the wheel`);
  driver.classList.toggle("person", !look && header.by === "person");
  byId("take").hidden = state.youDrive;
  const speed = header.ego?.speed_mps;
  setText(byId("speed"), typeof speed === "number" ? `${fixed(speed, 1)} m/s  ${fixed(speed * 3.6, 0)} km/h` : "");
  let pill = "";
  if (!look && header.ended) pill = `Simulation ended: ${header.ended}. R resets.`;
  else if (!look && !header.playing) pill = "Paused. P continues.";
  setText(byId("pill"), pill);
  byId("pill").hidden = !pill;
  setText(byId("command"), header.command ?? "");
}

function showStats({ times_ms: times = {} }) {
  const ms = (value) => (typeof value === "number" ? `${fixed(value, 0)} ms` : "?");
  setText(byId("stats"), `${shown.length} fps, draw ${ms(times.draw)}, encode ${ms(times.encode)}, page ${ms(pageMs)}, left out ${dropped}, ${state.clients === 1 ? "1 client" : `${state.clients} clients`}`);
}

async function copyCommand() {
  const text = byId("command").textContent;
  // The command of a drive reads its trajectory from a file.
  if (simulating() && state.youDrive && state.frame.takeover !== null) send("trajectory");
  let copied = true;
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    const range = document.createRange();
    range.selectNodeContents(byId("command"));
    getSelection().removeAllRanges();
    getSelection().addRange(range);
    copied = document.execCommand?.("copy") ?? false;
  }
  byId("copy").blur();
  notice(copied ? "The command is copied." : "The browser does not allow to copy; the command is selected.");
}
