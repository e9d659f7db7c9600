#!/usr/bin/env python3
"""Bytes and time of a call: the denoiser protocol with all conditions in each call and with conditions by number, and the image protocol.

``python python/benches/denoiser_calls.py LOG SKELETON [--recipe pas-nuscenes] [--frames 3] [--rounds 3]`` generates frames with a
generator that answers zeros at once, with the conditions of a window in each form. The time of a call is that from an answer to the next
message: the sampler's step, writing, and reading; of the first call of a frame, also simulation and rendering. Prints medians over the
calls, of the first call of each frame and of all others.
"""

import argparse
import json
import math
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

FORMS = ("all in each call", "by number", "images")
MAPS = ("color", "depth", "boxes", "map")
CHANNELS, FACTOR = 16, 8  # of the latents of Stable Diffusion 3
WINDOW = 12  # frames, of the recipe


def serve(form: str, report: Path) -> None:
    """Answer with zeros; writes bytes and seconds of each call as JSON lines, and null between frames."""
    source, out = sys.stdin.buffer, sys.stdout.buffer

    def message() -> bytes:
        prefix = source.read(8)
        return source.read(*struct.unpack("<Q", prefix)) if prefix else b""

    def texts(content: bytes) -> dict[str, str]:
        (length,) = struct.unpack_from("<Q", content)
        found: dict[str, str] = json.loads(content[8 : 8 + length])["__metadata__"]
        return found

    def write(said: dict[str, str], names: Sequence[str] = (), shape: tuple[int, ...] = (), dtype: str = "F32") -> None:
        """Send texts and tensors of zeros of one shape."""
        size = {"F32": 4, "U8": 1}[dtype] * math.prod(shape)
        tensors = {name: {"dtype": dtype, "shape": shape, "data_offsets": [i * size, (i + 1) * size]} for i, name in enumerate(names)}
        header = json.dumps({"__metadata__": said, **tensors}).encode()
        data = bytes(size * len(names))
        out.write(struct.pack("<QQ", 8 + len(header) + len(data), len(header)) + header + data)
        out.flush()

    hello = texts(message())
    height, width = (int(side) for side in hello["condition_size"].split(","))
    calls, end = report.open("w", buffering=1), 0.0

    def asked() -> Iterator[dict[str, str]]:
        """Texts of the messages, of which bytes and seconds are written."""
        while content := message():
            seconds, said = time.perf_counter() - end, texts(content)
            calls.write(json.dumps([len(content), seconds] if said["ask"] in ("predict", "generate") else None) + "\n")
            yield said

    answer = {"version": "1", "image_size": hello["condition_size"]}
    if form == FORMS[2]:
        window = str(WINDOW - 1)
        shape = (len(json.loads(hello["cameras"])), height, width, 3)
        said = {"protocol": "pskel-images", "maps": json.dumps(MAPS), "references": window, "history": "3", "forecasts": window}
        write({**answer, **said})
        end = time.perf_counter()
        for _ in asked():
            calls.write("null\n")
            write({}, ["images"], shape, "U8")
            end = time.perf_counter()
        return
    latent = (int(hello["views"]), CHANNELS, height // FACTOR, width // FACTOR)
    said = {"protocol": "pskel-denoiser", "dtype": "F32", "latent_shape": ",".join(map(str, latent))}
    write({**answer, **said, "guidance": "true", "frames": "true" if form == FORMS[1] else "false"})
    end = time.perf_counter()
    for request in asked():
        if request["ask"] == "predict":
            write({}, ("prediction", "unconditional"), (int(hello["window"]), *latent))
        else:
            write({}, ["latents"], latent) if request["ask"] == "encode" else write({}, ["images"], (latent[0], 3, height, width))
        end = time.perf_counter()


def measure(given: argparse.Namespace, form: str, folder: Path) -> list[list[tuple[int, float]]]:
    """Bytes and seconds of the calls of each generated frame."""
    report = folder / "calls.jsonl"
    generator = f"{'images' if form == FORMS[2] else 'process'}:{sys.executable} {Path(__file__).resolve()} --serve '{form}' {report}"
    command = [sys.executable, "-m", "pskel", "generate", given.log, "--skeleton", given.skeleton, "--out", str(folder / "out")]
    options = ["--generator", generator, "--recipe", given.recipe, "--steps", str(WINDOW - 2 + given.frames)]
    options += ["--maps", "color", "--size", "90x160"]
    subprocess.run([*command, *options], check=True, stdout=subprocess.DEVNULL)
    frames: list[list[tuple[int, float]]] = [[]]
    for line in report.read_text().splitlines():
        entry = json.loads(line)
        if entry is not None:
            frames[-1].append((entry[0], entry[1]))
        elif frames[-1]:
            frames.append([])
    return [frame for frame in frames if frame]


def medians(calls: list[tuple[int, float]]) -> str:
    size, seconds = (statistics.median(values) for values in zip(*calls))
    return f"{size / 1e6:9.2f} MB {1e3 * seconds:7.0f} ms"


def main() -> None:
    if sys.argv[1:2] == ["--serve"]:
        serve(sys.argv[2], Path(sys.argv[3]))
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log")
    parser.add_argument("skeleton")
    parser.add_argument("--recipe", default="pas-nuscenes")
    parser.add_argument("--frames", type=int, default=3, help="generated frames")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=FORMS, help="default: all")
    given = parser.parse_args()
    calls: dict[str, list[list[tuple[int, float]]]] = {form: [] for form in given.forms}
    with tempfile.TemporaryDirectory() as scratch:
        for round_ in range(given.rounds):
            for form in given.forms:
                folder = Path(scratch) / f"{round_}-{form.replace(' ', '-')}"
                folder.mkdir()
                calls[form] += measure(given, form, folder)
    print(f"{'conditions':18} {'calls a frame':>13} {'MB a frame':>11} {'first call':>22} {'other calls':>22}")
    for form, frames in calls.items():
        size = statistics.median(sum(size for size, _ in frame) for frame in frames)
        first = [frame[0] for frame in frames]
        others = [call for frame in frames for call in frame[1:]]
        shown = [medians(some) if some else "none" for some in (first, others)]
        print(f"{form:18} {len(frames[0]):13} {size / 1e6:11.1f} {shown[0]:>22} {shown[1]:>22}")


if __name__ == "__main__":
    main()
