"""Frame times of `Renderer.render` and `render_all` in Python beside those of `pskel bench`, in turn, and of data loaders.

python render.py LOG SKELETON [--out-size 256x448] [--maps color,depth,class,instance,boxes,map] [--rounds 5] [--loader]

Prints Markdown: medians over the rounds of the median frame. `render` has one frame in flight, `render_all` two.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time

import pskel


def of_command(args: argparse.Namespace, in_flight: int) -> float:
    """Returns the median time of a frame in `pskel bench`, milliseconds."""
    command = ["-m", "pskel", "bench", args.log, "--skeleton", args.skeleton, "--maps", args.maps]
    options = ["--out-size", args.out_size, "--in-flight", str(in_flight), "--json"]
    done = subprocess.run([sys.executable, *command, *options], stdout=subprocess.PIPE, text=True, check=True)
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
    # As `pskel bench`, without the built-in templates.
    options = {"out_size": (height, width), "maps": args.maps.split(","), "default_templates": False}
    renderer = pskel.Renderer(pskel.Skeleton(args.skeleton), **options)  # type: ignore[arg-type]
    print("| frames in flight | `pskel bench` (ms) | Python (ms) | ratio, of each round |\n|---|---|---|---|")
    for in_flight in (1, 2):
        rounds = [(of_command(args, in_flight), of_python(renderer, scenes, in_flight)) for _ in range(args.rounds)]
        command, python = (statistics.median(times) for times in zip(*rounds, strict=True))
        ratios = ", ".join(f"{python / command:.3f}" for command, python in sorted(rounds, key=lambda r: r[1] / r[0]))
        print(f"| {in_flight} | {command:.1f} | {python:.1f} | {python / command:.3f} ({ratios}) |")
    renderer.close()
    if args.loader:
        loaders(args, (height, width))


if __name__ == "__main__":
    main()
