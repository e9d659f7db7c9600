#!/usr/bin/env python3
"""Renders the moving picture of README.md: ci/picture.py [OUT.webp] (default docs/images/rollout.webp)

Simulates a lane change in a synthetic town with generated images. The rows of the picture are maps of the front cameras,
generated images and ground truth, five times a second. Needs Pillow and the program PSKEL (default pskel). Renders into
the folder WORK (default a temporary one), whose rollout is reused if there is one."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageChops, ImageDraw, ImageFont

TOWN = "town:seed=7,frames=40,size=225x400"
CAMERAS = ["CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT"]
ROWS = ["color map", "depth map", "boxes and HD map", "generated image", "ground truth"]
WIDTH, HEIGHT, GAP = 256, 144, 4
STEPS = range(8, 50, 2)  # planning steps; the first three of a rollout have no generated image
# Near, .., far.
STOPS = [(253, 231, 37), (122, 209, 81), (34, 168, 132), (42, 120, 142), (65, 68, 135), (68, 1, 84)]


def simulate(work):
    """Builds the skeleton of the town, and simulates a lane change with generated images."""
    program = os.environ.get("PSKEL", "pskel")
    ego = f"--ego lane_change --actors idm --steps {STEPS[-1]} --generator network"
    maps = "--maps color,depth,boxes,map --depth-bins log --line-width fixed --splat 5:8,15:4,35:2,100:1"
    sizes = f"--size 450x800 --out-size {HEIGHT}x{WIDTH} --color-filter valid-area"
    folders = ["--skeleton", work / "skeleton", "--out", work / "rollout"]
    subprocess.run([program, "build", TOWN, "--out", work / "skeleton"], check=True)
    subprocess.run([program, "simulate", TOWN, *folders, *f"{ego} {maps} {sizes}".split()], check=True)


def colored(depth):
    """Returns a depth map of 256 bins in the colors of STOPS. Bin 0 is empty."""
    colors = [(0, 0, 0)]  # and yellow up to 3 m
    for i in range(255):
        stop, part = divmod(max(i - 70, 0) / 185 * (len(STOPS) - 1), 1)
        colors.append(tuple(round(a + (b - a) * part) for a, b in zip(STOPS[int(stop)], STOPS[int(stop) + 1])))
    image = Image.frombytes("P", depth.size, depth.tobytes()[1::2])  # the high byte of 255 * bin is bin - 1
    image.putpalette([level for color in colors for level in color])
    return image.convert("RGB")


def tile(step, camera, row):
    """Returns the image of a camera in a row."""
    if row in ("generated image", "ground truth"):
        image = Image.open(step / {"generated image": "generated", "ground truth": "truth"}[row] / f"{camera}.png")
        return image.convert("RGB").resize((WIDTH, HEIGHT), Image.Resampling.BICUBIC)
    if row == "boxes and HD map":
        return ImageChops.lighter(*(Image.open(step / camera / f"{name}.png") for name in ("boxes", "map")))
    if row == "depth map":
        return colored(Image.open(step / camera / "depth.png"))
    return Image.open(step / camera / "color.png")


def frame(step):
    """Returns the picture of a step: a row of cameras for each of ROWS, with its name."""
    canvas = Image.new("RGB", (len(CAMERAS) * WIDTH, len(ROWS) * (HEIGHT + GAP) - GAP), "white")
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(15)
    for i, row in enumerate(ROWS):
        top = i * (HEIGHT + GAP)
        for j, camera in enumerate(CAMERAS):
            canvas.paste(tile(step, camera, row), (j * WIDTH, top))
        draw.rectangle((0, top, draw.textlength(row, font) + 14, top + 23), fill="black")
        draw.text((7, top + 3), row, "white", font)
    return canvas


def main():
    out = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent / "docs/images/rollout.webp")
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(os.environ.get("WORK", scratch))
        if not (work / "rollout/index.html").exists():
            simulate(work)
        frames = [frame(work / f"rollout/steps/{step:06}") for step in STEPS]
    out.parent.mkdir(parents=True, exist_ok=True)
    times_ms = [200] * (len(frames) - 1) + [1000]
    frames[0].save(out, save_all=True, append_images=frames[1:], duration=times_ms, loop=0, quality=70, method=6)
    print(f"{out}: {len(frames)} frames, {frames[0].width}x{frames[0].height}, {out.stat().st_size / 1e6:.2f} MB")


main()
