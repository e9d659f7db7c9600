"""Frame times of `Renderer.render` and `render_all`, in turn with `pskel bench`, and of data loaders.

python render.py LOG SKELETON [--out-size 256x448] [--maps color,depth,class,instance,boxes,map] [--rounds 5] [--loader]
python render.py --points points.npy --cameras cameras.json [--maps color,depth,class,instance] ..

Prints Markdown: medians over the rounds of the median frame, and of the ratio in each round. `render` has one frame in
flight, `render_all` two.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pskel

REPEAT = 40  # frames of a single scene


def of_command(args: argparse.Namespace, maps: list[str], in_flight: int) -> float:
    """Returns the median time of a frame in `pskel bench`, milliseconds."""
    if args.points:
        work = ["--points", args.points, "--cameras", args.cameras, "--repeat", str(REPEAT)]
    else:
        work = [args.log, "--skeleton", args.skeleton]
    options = ["--maps", ",".join(maps), "--out-size", args.out_size, "--in-flight", str(in_flight), "--json"]
    command = [sys.executable, "-m", "pskel", "bench", *work, *options]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True)
    return float(json.loads(done.stdout)["frame_ms"]["median"])


def of_python(renderer: pskel.Renderer, scenes: list[pskel.Scene], in_flight: int) -> float:
    """Returns the median time of a frame in Python, milliseconds."""
    frames = iter(renderer.render_all(scenes[:3] + scenes) if in_flight == 2 else map(renderer.render, scenes[:3] + scenes))
    for _ in range(3):
        next(frames)
    times, start = [], time.perf_counter()
    for _ in frames:
        now = time.perf_counter()
        times.append(1e3 * (now - start))
        start = now
    return statistics.median(times)


def of_log(args: argparse.Namespace) -> tuple[pskel.Skeleton, list[pskel.Scene]]:
    log = pskel.Log(args.log)
    return pskel.Skeleton(args.skeleton), [log[i] for i in range(len(log))]


def of_points(args: argparse.Namespace, folder: Path) -> tuple[pskel.Skeleton, list[pskel.Scene]]:
    """Returns points and cameras of the files that the command reads."""
    skeleton = pskel.Skeleton.from_points(folder / "skeleton", np.load(args.points))
    listed = json.loads(Path(args.cameras).read_text())["cameras"]
    cameras = [
        pskel.Camera(c["name"], c["intrinsics"], (c["height"], c["width"]), np.linalg.inv(c["camera_from_world"]))
        for c in listed
    ]
    return skeleton, [pskel.Scene(np.eye(4), cameras)] * REPEAT


def loaders(args: argparse.Namespace, size: tuple[int, int]) -> None:
    from pskel.torch import ConditionDataset
    from torch.utils.data import DataLoader

    print("\n| workers | clips per second |\n|---|---|")
    for workers in (0, 1, 2):
        dataset = ConditionDataset([(args.log, args.skeleton)], out_size=size)
        context = "spawn" if workers else None
        loader = DataLoader(
            dataset, num_workers=workers, multiprocessing_context=context, persistent_workers=workers > 0
        )
        for _ in loader:  # workers open their devices
            pass
        start = time.perf_counter()
        for _ in loader:
            pass
        print(f"| {workers} | {len(dataset) / (time.perf_counter() - start):.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", nargs="?")
    parser.add_argument("skeleton", nargs="?")
    parser.add_argument("--points")
    parser.add_argument("--cameras")
    parser.add_argument("--out-size", default="256x448")
    parser.add_argument("--maps", default="color,depth,class,instance,boxes,map")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--loader", action="store_true")
    args = parser.parse_args()
    if (args.points and args.cameras) is None and args.skeleton is None:
        parser.error("expected LOG and SKELETON, or --points and --cameras")
    if args.loader and args.skeleton is None:
        parser.error("expected LOG and SKELETON with --loader")
    height, width = (int(side) for side in args.out_size.split("x"))
    maps = args.maps.split(",")
    with tempfile.TemporaryDirectory() as folder:
        skeleton, scenes = of_points(args, Path(folder)) if args.points else of_log(args)
        # As `pskel bench`, without the built-in templates, and points alone without a crop.
        options = {"out_size": (height, width), "maps": maps, "default_templates": False}
        renderer = pskel.Renderer(skeleton, radius=1e9 if args.points else 100.0, **options)  # type: ignore[arg-type]
        print("| frames in flight | `pskel bench` (ms) | Python (ms) | ratio (of each round) |\n|---|---|---|---|")
        for in_flight in (1, 2):
            rounds = [(of_command(args, maps, in_flight), of_python(renderer, scenes, in_flight)) for _ in range(args.rounds)]
            command, python = (statistics.median(times) for times in zip(*rounds, strict=True))
            ratios = sorted(python / command for command, python in rounds)
            each = ", ".join(f"{ratio:.3f}" for ratio in ratios)
            print(f"| {in_flight} | {command:.1f} | {python:.1f} | {statistics.median(ratios):.3f} ({each}) |")
        renderer.close()
    if args.loader:
        loaders(args, (height, width))


if __name__ == "__main__":
    main()
