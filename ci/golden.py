#!/usr/bin/env python3
"""Prints hashes of what `pskel` writes: ci/golden.py [PSKEL] [SHARED] > FILE.

Two versions of the program that print the same lines render the same maps. Covers skeletons, maps of the three
rasterizers as PNG and NPZ in full and reduced size, exports in every layout, and rollouts of 20 steps with and without
generated images; of a small synthetic log, and of the recordings in SHARED (PandaSet in the nuScenes and nuPlan
layouts) if the folder exists; of an Argoverse 2 log without images, only its description. A line is
`HASH COUNT WHAT`: the start of the SHA-256 of all files below a folder, and their number. Files with times, paths or
versions are left out.
"""

import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path

SKIPPED = {"rollout.json", "index.json", "index.html", "metrics.json", ".pskel-files", "rollout.mp4", "skeleton.json"}
RASTERIZERS = ["compute", "graphics", "cpu"]
LAYOUTS = ["frames", "pas-cache", "opendwm-preview", "webdataset", "mcap", "alpasim", "world-scenario", "cosmos-video"]
CLIPS = [
    ("streetcrafter", "town:seed=7,frames=25,hz=10,size=40x72", "320x576"),
    ("freevs", "town:seed=7,frames=6,size=45x80", "540x960"),
]


def show(folder, what):
    sha, count = hashlib.sha256(), 0
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in SKIPPED:
            sha.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
            count += 1
    if (folder / "skeleton.json").is_file():
        manifest = json.loads((folder / "skeleton.json").read_text())
        kept = {key: manifest[key] for key in ("report", "background", "actors", "templates") if key in manifest}
        sha.update(json.dumps(kept, sort_keys=True).encode())
    print(sha.hexdigest()[:24], count, what, flush=True)


def main():
    pskel = sys.argv[1] if len(sys.argv) > 1 else "target/release/pskel"
    shared = Path(sys.argv[2] if len(sys.argv) > 2 else "../shared") / "data"
    pandaset = shared / "pandaset-002"
    logs = [("town", "town:seed=7,frames=3,size=113x200", "0..3", "56x100")]
    if shared.is_dir():
        logs += [
            ("pandaset", f"nuscenes:{pandaset / 'nuscenes'}", "0..4", "256x448"),
            ("nuplan", f"nuplan:{pandaset / 'nuplan/nuplan-v1.1/splits/mini'}"
             "/2020.01.01.00.00.00_veh-02_00000_00079.db", "0..1", "256x448"),
            ("av2", f"av2:{next((shared / 'av2').glob('*-*'))}", None, None),
        ]
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)

        def run(*args):
            subprocess.run([pskel, *map(str, args)], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

        for name, log, frames, size in logs:
            if not size:
                # Exits with 1 for the missing images of an excerpt.
                info = subprocess.run([pskel, "info", "--json", log], capture_output=True)
                assert info.returncode in (0, 1) and json.loads(info.stdout)["frames"], info.stderr
                print(hashlib.sha256(info.stdout).hexdigest()[:24], 1, f"{name} info", flush=True)
                continue
            skeleton = scratch / f"{name}-skeleton"
            run("build", log, "--out", skeleton, "--templates")
            show(skeleton, f"{name} skeleton")
            for rasterizer in RASTERIZERS:
                for form in ("png", "npz"):
                    for out_size in (None, size):
                        out = scratch / "maps"
                        reduced = ["--out-size", out_size] if out_size else []
                        run("render", log, "--skeleton", skeleton, "--out", out, "--frames", frames, "--format", form,
                            "--rasterizer", rasterizer, *reduced)
                        show(out, f"{name} {rasterizer} {form} {out_size or 'full'}")
            if name != "nuplan":
                out = scratch / "rollout"
                run("simulate", log, "--skeleton", skeleton, "--out", out, "--steps", 20, "--ego", "straight",
                    "--actors", "idm", "--out-size", size)
                show(out, f"{name} rollout of 20 steps")
            if name != "nuplan":
                for layout in LAYOUTS:
                    out = scratch / f"{name}-{layout}"
                    images = ["--images"] if layout not in ("alpasim", "world-scenario", "cosmos-video") else []
                    run("export", log, "--layout", layout, "--skeletons", scratch / f"{name}-skeletons", "--out", out,
                        "--frames", "0..3", "--shard-frames", 2, "--out-size", size, *images)
                    show(out, f"{name} export {layout}")
            if name == "town":
                for layout, clips, clip_size in CLIPS:
                    out = scratch / f"clips-{layout}"
                    run("export", clips, "--layout", layout, "--skeletons", scratch / "clips-skeletons", "--out", out,
                        "--size", clip_size)
                    show(out, f"{name} export {layout}")
                for generator in ("fill", "network"):
                    out = scratch / f"generated-{generator}"
                    run("simulate", log, "--skeleton", skeleton, "--out", out, "--steps", 20, "--ego", "straight",
                        "--generator", generator)
                    show(out, f"{name} rollout of 20 steps, images of {generator}")


if __name__ == "__main__":
    main()
