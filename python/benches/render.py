"""Frame times of `Renderer.render_all` in a Python loop beside those of `pskel bench`, in turn, and of data loaders.

python render.py LOG SKELETON [--out-size 256x448] [--maps color,depth,class,instance,boxes,map] [--rounds 5] [--loader]

Prints Markdown. Frames of the command include no output; those of Python are dictionaries of arrays.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time

import pskel


def of_command(args: argparse.Namespace) -> float:
    """Returns the mean time of a frame in `pskel bench`, milliseconds."""
    command = ["-m", "pskel", "bench", args.log, "--skeleton", args.skeleton, "--maps", args.maps]
    done = subprocess.run(
        [sys.executable, *command, "--out-size", args.out_size, "--json"], capture_output=True, text=True, check=True
    )
    report = json.loads(done.stdout)
    return float(report["frame_ms"]["mean"])


def of_python(renderer: pskel.Renderer, scenes: list[pskel.Scene], series: bool) -> float:
    """Returns the mean time of a frame in Python, milliseconds."""
    for _ in renderer.render_all(scenes[:3]):
        pass
    start = time.perf_counter()
    if series:
        for maps in renderer.render_all(scenes):
            assert maps
    else:
        for scene in scenes:
            assert renderer.render(scene)
    return 1e3 * (time.perf_counter() - start) / len(scenes)


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
    parser.add_argument("log")
    parser.add_argument("skeleton")
    parser.add_argument("--out-size", default="256x448")
    parser.add_argument("--maps", default="color,depth,class,instance,boxes,map")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--loader", action="store_true")
    args = parser.parse_args()
    height, width = (int(side) for side in args.out_size.split("x"))
    log = pskel.Log(args.log)
    scenes = [log[i] for i in range(len(log))]
    times: dict[str, list[float]] = {"`pskel bench`": [], "`render_all`": [], "`render`": []}
    renderer = pskel.Renderer(pskel.Skeleton(args.skeleton), out_size=(height, width), maps=args.maps.split(","))
    for _ in range(args.rounds):
        times["`pskel bench`"].append(of_command(args))
        times["`render_all`"].append(of_python(renderer, scenes, series=True))
        times["`render`"].append(of_python(renderer, scenes, series=False))
    renderer.close()
    base = statistics.median(times["`pskel bench`"])
    print("| frame of all cameras | median ms | smallest | largest | ratio |\n|---|---|---|---|---|")
    for name, values in times.items():
        median = statistics.median(values)
        print(f"| {name} | {median:.1f} | {min(values):.1f} | {max(values):.1f} | {median / base:.3f} |")
    if args.loader:
        loaders(args, (height, width))


if __name__ == "__main__":
    main()
