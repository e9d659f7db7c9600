#!/usr/bin/env python3
"""Time of a request for all cameras of a frame to ``pskel.serve``, beside the same frame by ``pskel.Renderer``, in turn.

``python python/benches/serve.py LOG SKELETON [--size 256x448] [--rounds 5]``; prints medians in milliseconds and ratios.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pskel

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from pskel.alpasim import sensorsim_pb2
from sensorsim_client import batch, requests, server, stub

FORMATS = {"PNG": sensorsim_pb2.PNG, "JPEG": sensorsim_pb2.JPEG}


def seconds(work: Callable[[int], object], frames: int) -> float:
    """Mean time of a frame."""
    start = time.perf_counter()
    for frame in range(frames):
        work(frame)
    return (time.perf_counter() - start) / frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log")
    parser.add_argument("skeleton")
    parser.add_argument("--size", default="256x448")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    height, width = map(int, given.size.split("x"))
    log = pskel.Log(given.log)
    frames = min(len(log), 20)
    renderer = pskel.Renderer(pskel.Skeleton(given.skeleton), size=(height, width), maps=["color", "depth"], log=log.name)
    with server(given.skeleton, f"--log={given.log}", "--images=color") as (_, address):
        client = stub(address)
        available = client.get_available_cameras(sensorsim_pb2.AvailableCamerasRequest(scene_id=log.name))
        asked = [requests(log, log[frame], available) for frame in range(frames)]
        works: dict[str, Callable[[int], object]] = {"Renderer": lambda frame: renderer.render(log[frame])}
        for name, number in FORMATS.items():
            messages = []
            for frame in asked:
                for request in frame.values():
                    request.resolution_h, request.resolution_w, request.image_format = height, width, number
                messages.append(batch(frame))
            works[name] = lambda frame, messages=messages: client.batch_render_rgb(messages[frame])
        times: dict[str, list[float]] = {name: [] for name in works}
        for round_ in range(given.rounds + 1):
            for name, work in works.items():
                took = seconds(work, frames)
                if round_ > 0:  # the first one opens the scene
                    times[name].append(took)
    for name, found in times.items():
        ratios = np.array(found) / np.array(times["Renderer"])
        print(f"{name}: {1e3 * statistics.median(found):.1f} ms, {np.median(ratios):.3f} ({ratios.min():.3f} to {ratios.max():.3f})")


if __name__ == "__main__":
    main()
