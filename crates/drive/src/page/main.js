// Starts the page.

import { startBirdseye } from "./birdseye.js";
import { connect } from "./connection.js";
import { startControls } from "./controls.js";
import { startInspector } from "./inspector.js";
import { startKeys } from "./keys.js";
import { startStatus } from "./status.js";
import { startTimeline } from "./timeline.js";
import { startTraces } from "./traces.js";
import { startView } from "./view.js";

const random = /^#random=(\d+)(?:&seed=(\d+))?$/.exec(location.hash);
const test = location.hash === "#selftest" || random ? await import("./selftest.js") : null;
test?.watchErrors();
for (const start of [startStatus, startView, startBirdseye, startControls, startTimeline, startTraces, startInspector, startKeys]) start();
connect();
if (random) test.run(() => test.randomTest(Number(random[1]), Number(random[2] ?? 1)));
else test?.run(test.selfTest);
