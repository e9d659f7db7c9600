"""Golden maps of a log: ``python -m pskel.golden make LOG FILE`` writes their hashes, ``.. check LOG FILE`` compares.

All rasterizers render the same bytes on any device and with any number of threads, so hashes made on one machine hold on all.
Arrays are hashed, not image files. ``check`` also measures frames per second, for the summary of a job, and compares them with
the run before.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import Error, Log, Renderer, Skeleton, __version__, build
from ._whole import write_whole

__all__ = ["Rate", "check", "make"]

#: Hashes by frame, camera and map.
Hashes = dict[str, dict[str, dict[str, str]]]

_FRAMES = (0, 3)
_SIZE = (256, 448)
#: Times that the frames are rendered to measure them, after once to hash them.
_ROUNDS = 3


class Rate(NamedTuple):
    """Frames per second of a rasterizer, on a device."""

    rasterizer: str
    device: str
    frames_per_s: float


def _render(log: Log, skeleton: Skeleton, golden: dict[str, Any], rasterizer: str) -> tuple[Hashes, Rate]:
    """Hash the maps of some frames, and measure them."""
    scenes = log[slice(*golden["frames"])]
    with Renderer(skeleton, maps=golden["maps"], out_size=golden["out_size"], rasterizer=rasterizer) as renderer:
        hashes: Hashes = {}
        for scene in scenes:
            arrays = {name: np.asarray(array) for name, array in renderer.render(scene).items()}
            hashes[scene.name] = {
                camera: {name: hashlib.sha256(array[i].tobytes()).hexdigest()[:32] for name, array in arrays.items()}
                for i, camera in enumerate(scene.cameras)
            }
        times = []
        for scene in scenes * _ROUNDS:
            start = time.perf_counter()
            renderer.render(scene)
            times.append(time.perf_counter() - start)
        return hashes, Rate(rasterizer, renderer.device, 1 / statistics.median(times))


@contextmanager
def _skeleton_of(log: Log, skeleton: Skeleton | None) -> Iterator[Skeleton]:
    """Yield a skeleton, or one that is built for as long."""
    if skeleton is not None:
        yield skeleton
        return
    with tempfile.TemporaryDirectory(prefix="pskel-") as folder:
        yield build(log, folder)


def make(
    log: Log,
    path: str | os.PathLike[str],
    *,
    frames: tuple[int, int] = _FRAMES,
    out_size: tuple[int, int] = _SIZE,
    maps: Sequence[str] = ("color", "depth", "class", "instance"),
    skeleton: Skeleton | None = None,
) -> int:
    """Write the hashes of the maps of frames ``frames[0] .. frames[1] - 1``; return their number.

    The skeleton of the log is built, unless one is given. Raises ``ValueError`` if the log does not have the frames.
    """
    if not 0 <= frames[0] < frames[1] <= len(log):
        raise ValueError(f"expected frames A..B in 0..{len(log)}, found {frames[0]}..{frames[1]}")
    golden = {"pskel": __version__, "frames": list(frames), "out_size": list(out_size), "maps": list(maps)}
    with _skeleton_of(log, skeleton) as used:
        hashes, _ = _render(log, used, golden, "cpu")
    write_whole(Path(path), json.dumps({**golden, "hashes": hashes}, indent=1).encode() + b"\n")
    return sum(len(of) for cameras in hashes.values() for of in cameras.values())


def _read(path: str | os.PathLike[str], what: str, fields: Sequence[str] = ()) -> dict[str, Any]:
    try:
        found = json.loads(Path(path).read_text())
    except ValueError as error:
        raise ValueError(f"{path}: expected {what}, found no JSON: {error}") from error
    if not isinstance(found, dict) or not set(fields) <= set(found):
        raise ValueError(f"{path}: expected {', '.join([what, *fields])}; found another file")
    return found


def _differences(found: Hashes, golden: Hashes) -> list[str]:
    """Name the maps that differ or that only one side has."""
    def flat(hashes: Hashes) -> dict[str, str]:
        return {
            f"{frame}/{camera}/{name}": value
            for frame, cameras in hashes.items()
            for camera, of in cameras.items()
            for name, value in of.items()
        }

    a, b = flat(found), flat(golden)
    return sorted(name for name in a.keys() | b.keys() if a.get(name) != b.get(name))


def check(
    log: Log, path: str | os.PathLike[str], *, rasterizers: Sequence[str] = ("cpu",), skeleton: Skeleton | None = None
) -> tuple[dict[str, list[str]], list[Rate]]:
    """Render the golden frames of a log with each rasterizer, from a skeleton that is built unless one is given, and compare.

    Returns the maps that differ, ``FRAME/CAMERA/MAP``, by rasterizer, and the rates. Raises ``ValueError`` if ``path`` is no file
    of :func:`make`, or if the log does not have its frames.
    """
    golden = _read(path, "golden maps of pskel.golden make", ["frames", "hashes", "maps", "out_size"])
    if not golden["frames"][1] <= len(log):
        raise ValueError(f"{path}: expected a log with {golden['frames'][1]} frames or more, found {len(log)}")
    differences, rates = {}, []
    with _skeleton_of(log, skeleton) as used:
        for rasterizer in rasterizers:
            hashes, rate = _render(log, used, golden, rasterizer)
            differences[rasterizer] = _differences(hashes, golden["hashes"])
            rates.append(rate)
    return differences, rates


def _table(differences: dict[str, list[str]], rates: list[Rate], last: dict[str, float], path: str) -> str:
    """Return the summary of a job as Markdown."""
    lines = [f"### Condition maps of {Path(path).name}", "", "| rasterizer | device | maps | frames per second | to the last run |"]
    lines.append("|---|---|---|---|---|")
    for rate in rates:
        differ = len(differences[rate.rasterizer])
        before = last.get(rate.rasterizer)
        ratio = f"{rate.frames_per_s / before:.2f}" if before else "-"
        says = f"{differ} differ" if differ else "equal"
        lines.append(f"| {rate.rasterizer} | {rate.device} | {says} | {rate.frames_per_s:.1f} | {ratio} |")
    return "\n".join(lines) + "\n"


def _numbers(split: str) -> Any:
    def parse(text: str) -> tuple[int, int]:
        first, _, second = text.partition(split)
        return int(first), int(second)

    parse.__name__ = f"A{split}B"
    return parse


def _main() -> int:
    parser = argparse.ArgumentParser(prog="python -m pskel.golden", description="Golden maps: hashes that hold on all machines.")
    commands = parser.add_subparsers(dest="command", required=True)
    makes = commands.add_parser("make", help="write the hashes of a log's maps")
    checks = commands.add_parser("check", help="compare a log's maps with these hashes, and measure")
    for command in (makes, checks):
        command.add_argument("log", help="as for pskel build")
        command.add_argument("file", help="JSON file with the hashes")
        command.add_argument("--skeleton", metavar="SKEL", help="by default it is built, from all frames")
    makes.add_argument("--frames", type=_numbers(".."), default=_FRAMES, metavar="A..B", help="default 0..3")
    makes.add_argument("--out-size", type=_numbers("x"), default=_SIZE, metavar="HxW", help="size of the maps, default 256x448")
    makes.add_argument("--maps", default="color,depth,class,instance", help="default %(default)s")
    checks.add_argument("--rasterizers", default="cpu", help="such as cpu,compute; default %(default)s")
    checks.add_argument("--rates", metavar="F.json", help="frames per second of the last run; replaced")
    checks.add_argument("--summary", metavar="F.md", help="append a table, as to $GITHUB_STEP_SUMMARY")
    given = parser.parse_args()
    log, skeleton = Log(given.log), Skeleton(given.skeleton) if given.skeleton else None
    if given.command == "make":
        maps = given.maps.split(",")
        count = make(log, given.file, frames=given.frames, out_size=given.out_size, maps=maps, skeleton=skeleton)
        print(f"{given.file}: {count} maps")
        return 0
    rates_file = given.rates and Path(given.rates)
    last = _read(rates_file, "frames per second by rasterizer") if rates_file and rates_file.exists() else {}
    differences, rates = check(log, given.file, rasterizers=given.rasterizers.split(","), skeleton=skeleton)
    table = _table(differences, rates, last, given.file)
    print(table, end="")
    if given.summary:
        with Path(given.summary).open("a") as summary:
            summary.write(table)
    if rates_file:
        write_whole(rates_file, json.dumps({rate.rasterizer: rate.frames_per_s for rate in rates}).encode() + b"\n")
    for rasterizer, names in differences.items():
        for name in names:
            print(f"{rasterizer}: {name} differs from {given.file}", file=sys.stderr)
    return 1 if any(differences.values()) else 0


if __name__ == "__main__":
    try:
        sys.exit(_main())
    except (Error, OSError, ValueError) as error:
        sys.exit(f"pskel.golden: {error}")
