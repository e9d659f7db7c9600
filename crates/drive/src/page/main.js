// Starts the page.

import { startBirdseye } from "./birdseye.js";
import { connect } from "./connection.js";
import { startControls } from "./controls.js";
import { startGenerator } from "./generator.js";
import { startInspector } from "./inspector.js";
import { startKeys } from "./keys.js";
import { startStatus } from "./status.js";
import { startTimeline } from "./timeline.js";
import { startTraces } from "./traces.js";
import { startView } from "./view.js";

const random = /^#random=(\d+)(?:&seed=(\d+))?$/.exec(location.hash);
const visit = /^#selftest(?:&size=(\d+)x(\d+))?$/.exec(location.hash);
const show = /^#show=(\w+)$/.exec(location.hash);
const testing = visit || random || show;
const finished = testing ? holdLoading() : null;
const test = testing ? await import("./selftest.js") : null;
test?.watchErrors();
for (const start of [startStatus, startView, startBirdseye, startControls, startGenerator, startTimeline, startTraces, startInspector, startKeys]) start();
connect();
if (random) test.run(() => test.randomTest(Number(random[1]), Number(random[2] ?? 1))).then(finished);
else if (show) test.run(() => test.show(show[1])).then(finished);
else test?.run(() => test.selfTest(visit[1] ? [Number(visit[1]), Number(visit[2])] : null)).then(finished);

// The page counts as loading until the function returned is called, so that `chromium --dump-dom` waits for a test.
function holdLoading() {
  const frame = document.createElement("iframe");
  frame.hidden = true;
  document.body.append(frame);
  frame.contentDocument.open();
  return () => frame.contentDocument.close();
}
