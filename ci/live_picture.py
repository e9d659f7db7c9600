#!/usr/bin/env python3
"""Records the moving picture of the live page: ci/live_picture.py [OUT.webp] (default docs/images/drive.webp)

Headless Chromium opens the page of `pskel drive` on a synthetic town; a person swerves to the left and back, step by step,
while the page shows one map after another. Needs Pillow, websockets, Chromium and the program PSKEL (default pskel)."""

import base64
import io
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from PIL import Image
from websockets.sync.client import connect

TOWN = "town:seed=7,frames=40,size=256x448"
WINDOW, SIZE = (1280, 720), (960, 540)
STEPS, EVERY = 108, 4  # at 20 steps per second
MAPS = {0: "color", 56: "depth", 76: "class", 92: "color"}
# Steering from a step on, both multiples of EVERY.
STEER = {12: 0.12, 28: -0.12, 60: 0.12, 76: 0.0}
CHROMIUM = next(filter(None, map(shutil.which, ["chromium", "chromium-browser", "google-chrome"])), "chromium")
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars", "--remote-debugging-port=0"]
# Waits until the page shows a frame with a property.
WAIT = """new Promise(async (done) => {
  const { state } = await import("/page/store.js");
  const { send } = await import("/page/connection.js");
  const all = [...document.querySelectorAll("#maps button")];
  ACTION;
  const timer = setInterval(() => { if (state.frame && CONDITION) { clearInterval(timer); setTimeout(done, 400); } }, 10);
})"""


def record(page, address):
    """Yields pictures of the page."""
    numbers = itertools.count()

    def call(method, **params):
        number = next(numbers)
        page.send(json.dumps({"id": number, "method": method, "params": params}))
        while (answer := json.loads(page.recv())).get("id") != number:
            pass
        if "error" in answer or "exceptionDetails" in answer["result"]:
            raise RuntimeError(f"{method}: {answer}")
        return answer["result"]

    def wait(condition, action=""):
        text = WAIT.replace("ACTION", action).replace("CONDITION", condition)
        call("Runtime.evaluate", expression=text, awaitPromise=True)

    width, height = WINDOW
    call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
    call("Page.navigate", url=address)
    time.sleep(2)
    paused = 'document.head.append(Object.assign(document.createElement("style"), { textContent: "#pill { display: none }" }))'
    call("Runtime.evaluate", expression=paused)  # between the steps
    wait('state.frame.mode === "simulate"', 'send("simulate", { hz: 20, actors: "idm" })')
    for step in range(0, STEPS + 1, EVERY):
        if step in MAPS:
            shown = f'state.frame.images[0].map === "{MAPS[step]}"'
            wait(shown, f'all.find((node) => node.dataset.value === "{MAPS[step]}").click()')
        if step in STEER:
            wait("true", f'send("keys", {{ throttle: 0.1, steer: {STEER[step]} }})')
        if step:
            wait(f"state.frame.step === {step}", f'send("step", {{ count: {EVERY} }})')
        picture = base64.b64decode(call("Page.captureScreenshot", format="png")["data"])
        yield Image.open(io.BytesIO(picture)).convert("RGB").resize(SIZE, Image.Resampling.LANCZOS)


def main():
    """Writes the picture."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent.parent / "docs/images/drive.webp")
    with tempfile.TemporaryDirectory() as work:
        command = [os.environ.get("PSKEL", "pskel"), "drive", TOWN, "--out", work, "--port", "0", "--no-browser"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        browser = subprocess.Popen([CHROMIUM, *FLAGS, f"--user-data-dir={work}/browser"], stderr=subprocess.DEVNULL)
        try:
            address = server.stdout.readline().strip()
            port = Path(work, "browser/DevToolsActivePort")
            while not (port.exists() and port.read_text()):
                time.sleep(0.1)
            with urllib.request.urlopen(f"http://127.0.0.1:{port.read_text().split()[0]}/json") as answer:
                tab = next(tab for tab in json.load(answer) if tab["type"] == "page")
            with connect(tab["webSocketDebuggerUrl"], max_size=None) as page:
                first, *others = record(page, address)
        finally:
            for process in (browser, server):
                process.terminate()
                process.wait()
    options = {"save_all": True, "append_images": others, "duration": 200, "loop": 0, "quality": 60, "method": 6}
    first.save(out, **options)
    print(f"{len(others) + 1} pictures, {out.stat().st_size / 1e6:.2f} MB: {out}")


if __name__ == "__main__":
    main()
