#!/usr/bin/env python3
"""Compares the frame times of pskel with other programs that render the same points into the same cameras.

The peers' folder contains `street.py` (OUT_DIR N, writes points.npy and cameras.json), `native/` (a Cargo package;
POINTS CAMERAS REPEAT, prints JSON with reduced_ms, full_ms and filled), `numpy_splat.py` (POINTS CAMERAS, prints JSON
with seconds and filled) and `torch_splat.py` (POINTS CAMERAS DEVICE REPEAT, prints JSON with device_ms, host_ms, filled and
device). It may be read-only: `native` is built in a copy.

Python programs run in the Python that runs this script. `--torch` needs PyTorch there, and runs on a GPU if PyTorch finds
one, with pskel by `--rasterizer compute`. Otherwise both run on the processor. `torch_splat.py` makes color, depth and class:
once they stay on its device, once they are copied to host memory (on the processor the same), where pskel's maps always end.

All programs run alternately in rounds, so that changes of the machine's speed affect all of them. Each run reports its
median; the Markdown tables on stdout contain medians over the rounds and ratios of those medians, with the minimum
and maximum over the rounds. Fails if a program fails or fills different pixels.

    ci/compare_peers.py --peers DIR --points 4e6 --rounds 5 --work DIR [--graphics] [--numpy] [--torch] [--no-native]
    ci/compare_peers.py --peers DIR --points 4e6,40e6,100e6 --maps color,depth,class --torch --no-native
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUT_SIZE = "256x448"
# Number of threads of all programs, unless set in the environment.
THREADS = {"RAYON_NUM_THREADS": "2", "LP_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
# Programs round divisions differently, so a few points fall into a neighboring pixel.
FILLED_TOLERANCE = 1e-3
# Warm-up frames of pskel.
WARM_UP = 3
# Slow programs render one frame of this many.
SLOW_PART = 4


class Failure(Exception):
    """A failed check: the expected and the actual result."""


def say(text):
    print(f"compare: {text}", file=sys.stderr, flush=True)


def run(command, **options):
    """Runs a command and returns its standard output. Shows its standard error only on failure."""
    command = [str(part) for part in command]
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    if done.returncode != 0:
        shown = " ".join(command)
        raise Failure(f"expected exit code 0, found {done.returncode}: {shown}\n{done.stderr[-2000:]}")
    return done.stdout


def run_json(command):
    """Runs a command and returns the JSON object that it prints."""
    text = run(command)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        shown = " ".join(str(part) for part in command)
        raise Failure(f"expected a JSON object on stdout, found {text[:80]!r}: {shown}") from error


@dataclass
class Series:
    """Median times of one program at one size, one per round, in milliseconds."""

    ms: list = field(default_factory=list)
    filled: int | None = None

    def median(self):
        return statistics.median(self.ms)


class Results:
    """Series by program and size, in the order of their first run."""

    def __init__(self):
        self.series = {}
        self.pskel = {}
        self.torch = None

    def add(self, program, size, ms, filled):
        series = self.series.setdefault((program, size), Series())
        series.ms.append(float(ms))
        series.filled = filled

    def check_filled(self):
        """Checks that all programs that count filled pixels agree."""
        for size in ("reduced", "full"):
            of_size = {name: s.filled for (name, at), s in self.series.items() if at == size}
            counts = [filled for filled in of_size.values() if filled is not None]
            if counts and max(counts) - min(counts) > FILLED_TOLERANCE * max(counts):
                raise Failure(f"expected all programs to fill the same pixels of {size} maps, found {of_size}")


def copy_package(source, target):
    """Copies a Cargo package with its .cargo folder, without file modes (it may be read-only) and build output."""
    for folder, folders, files in os.walk(source):
        folders[:] = [name for name in folders if name not in ("target", ".git")]
        into = target / Path(folder).relative_to(source)
        into.mkdir(parents=True, exist_ok=True)
        for name in files:
            new = into / name
            old_bytes = (Path(folder) / name).read_bytes()
            if not new.is_file() or new.read_bytes() != old_bytes:  # an unchanged file does not trigger a rebuild
                new.write_bytes(old_bytes)


def build_native(peers, work):
    """Builds the native peer in a copy of its package and returns the path of the binary."""
    package = work / "native"
    copy_package(peers / "native", package)
    say(f"building {package}")
    target = package / "target"
    # Cargo reads .cargo/config relative to the working directory.
    build = ["cargo", "build", "--release", "--quiet", "--target-dir", target, "--message-format", "json"]
    for line in run(build, cwd=package).splitlines():
        message = json.loads(line)
        if message.get("reason") == "compiler-artifact" and message.get("executable"):
            return Path(message["executable"])
    raise Failure(f"expected a binary of the package, found none: {package}")


def make_street(peers, work, points):
    """Returns point and camera files, created once per folder."""
    folder = work / f"street-{points}"
    files = folder / "points.npy", folder / "cameras.json"
    if all(file.is_file() for file in files):
        say(f"street of an earlier run: {folder}")
    else:
        say(f"generating a street of {points} points: {folder}")
        shutil.rmtree(folder, ignore_errors=True)
        new = work / f"street-{points}.new"
        shutil.rmtree(new, ignore_errors=True)
        run([sys.executable, peers / "street.py", new, points])
        new.rename(folder)
    return files


@dataclass
class Torch:
    """The PyTorch of this Python: its version, and the device that it runs on ("cuda" or "cpu")."""

    version: str
    device: str


def find_torch():
    try:
        import torch
    except ImportError as error:
        raise Failure(f"expected PyTorch (pip install torch), found {error}: {sys.executable}") from error
    found = Torch(torch.__version__, "cuda" if torch.cuda.is_available() else "cpu")
    if found.device == "cpu":
        say(f"PyTorch {found.version} finds no GPU: torch runs on the processor")
    return found


class Bench:
    """Runs the programs and collects their results."""

    def __init__(self, args, native, torch, street):
        self.args, self.native, self.torch = args, native, torch
        self.points, self.cameras = street
        self.few = max(1, args.repeat // SLOW_PART)
        self.results = Results()

    def round(self):
        if self.native:
            self.run_native()
        self.pskel("pskel", self.rasterizer(), self.args.repeat, WARM_UP)
        if self.args.graphics:
            self.pskel("pskel graphics", "graphics", self.few, 1)
        if self.args.numpy:
            peer = self.run_python("numpy_splat.py")
            self.results.add("numpy", "full", 1e3 * peer["seconds"], peer.get("filled"))
        if self.torch:
            self.run_torch()

    def rasterizer(self):
        """What pskel draws by: unless chosen, it runs where torch does."""
        usual = {"cuda": "compute", "cpu": "cpu"}[self.torch.device] if self.torch else "auto"
        return self.args.rasterizer or usual

    def run_native(self):
        peer = run_json([self.native, self.points, self.cameras, self.args.repeat])
        self.results.add("native", "reduced", peer["reduced_ms"], None)
        self.results.add("native", "full", peer["full_ms"], peer.get("filled"))

    def run_python(self, name, *extra):
        return run_json([sys.executable, self.args.peers / name, self.points, self.cameras, *extra])

    def run_torch(self):
        frames = self.few if self.torch.device == "cpu" else self.args.repeat
        peer = self.run_python("torch_splat.py", self.torch.device, frames)
        self.results.add("torch, maps on its device", "full", peer["device_ms"], peer["filled"])
        self.results.add("torch, maps in host memory", "full", peer["host_ms"], peer["filled"])
        self.results.torch = f"PyTorch {self.torch.version} on {peer['device']}, medians of {frames} frames"

    def pskel(self, program, rasterizer, repeat, warm_up):
        command = [self.args.pskel, "bench", "--points", self.points, "--cameras", self.cameras, "--json"]
        command += ["--maps", self.args.maps, "--rasterizer", rasterizer]
        command += ["--repeat", repeat, "--warm-up", warm_up]
        for size, extra in (("reduced", ["--out-size", OUT_SIZE]), ("full", [])):
            found = run_json(command + extra)
            self.results.add(program, size, found["frame_ms"]["median"], found["filled"])
            self.results.pskel.setdefault(program, found)


def times_table(results):
    yield "| program | maps | ms a frame | min..max of rounds | filled pixels |"
    yield "|---|---|---|---|---|"
    for (program, size), series in results.series.items():
        spread = f"{min(series.ms):.1f}..{max(series.ms):.1f}"
        filled = "" if series.filled is None else series.filled
        yield f"| {program} | {size} | {series.median():.1f} | {spread} | {filled} |"


def ratios_table(results):
    """Formats the speedup of pskel over each other program; values below 1 mean slower."""
    yield "| ratio | maps | of medians | min..max of rounds |"
    yield "|---|---|---|---|"
    for (program, size), other in results.series.items():
        own = results.series.get(("pskel", size))
        if program == "pskel" or own is None:
            continue
        rounds = [a / b for a, b in zip(other.ms, own.ms)]
        ratio = other.median() / own.median()
        yield f"| {program} : pskel | {size} | {ratio:.2f} | {min(rounds):.2f}..{max(rounds):.2f} |"


def heading(args, results):
    """Describes the programs, the data and the machine."""
    pskel = results.pskel["pskel"]
    threads = ", ".join(f"{name}={os.environ[name]}" for name in THREADS)
    yield f"{pskel['points']} points, {pskel['cameras']} cameras of {pskel['size']}, reduced to {OUT_SIZE} or full;"
    yield f"{args.rounds} rounds, medians of {args.repeat} frames each; {threads}; pskel makes {args.maps}."
    for program, found in results.pskel.items():
        yield f"`{program}`: rasterizer {found['rasterizer']} on {found['device']}, driver {found['driver']}."
    if results.torch:
        yield f"`torch`: {results.torch}."


def check_peers(args):
    """Checks that all programs exist."""
    needed = ["street.py"] + ["numpy_splat.py"] * args.numpy + ["torch_splat.py"] * args.torch
    needed += ["native/Cargo.toml"] * (args.native and args.native_bin is None)
    missing = [name for name in needed if not (args.peers / name).is_file()]
    if missing:
        raise Failure(f"expected {', '.join(needed)}, found no {', '.join(missing)}: {args.peers}")


def compare(args, work):
    """Builds the programs and compares them at each number of points."""
    check_peers(args)
    torch = find_torch() if args.torch else None
    native = (args.native_bin or build_native(args.peers, work)) if args.native else None
    for number, points in enumerate(args.points):
        if number > 0:
            print()
        compare_street(args, Bench(args, native, torch, make_street(args.peers, work, points)))


def compare_street(args, bench):
    """Runs the rounds on one street and prints the tables."""
    for number in range(args.rounds):
        say(f"round {number + 1} of {args.rounds}")
        bench.round()
    results = bench.results
    parts = heading(args, results), times_table(results), ratios_table(results)
    print("\n\n".join("\n".join(part) for part in parts), flush=True)
    results.check_filled()


def count(least):
    def parse(text):
        value = float(text)
        if value != int(value) or value < least:
            raise ValueError(text)
        return int(value)

    parse.__name__ = f"number of {least} or more"  # argparse puts it into its message
    return parse


def points_list(text):
    return [count(1)(part) for part in text.split(",")]


points_list.__name__ = "list of numbers of 1 or more"


def file(text):
    path = Path(text).resolve()
    if not path.exists():
        raise argparse.ArgumentTypeError(f"expected a file or folder, found none: {text}")
    return path


def parse_args():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", type=file, required=True, help="folder of the other programs")
    parser.add_argument("--points", type=points_list, default=[4_000_000],
                        help="of the street, like 4e6 (default), or of several ones, like 4e6,40e6")
    parser.add_argument("--rounds", type=count(1), default=5, help="default 5")
    parser.add_argument("--repeat", type=count(1), default=20, help="timed frames a run (default 20)")
    parser.add_argument("--work", type=Path, help="folder for the street and the build (default: a temporary one)")
    parser.add_argument("--pskel", type=Path, default=ROOT / "target/release/pskel",
                        help="default: target/release/pskel of this checkout")
    parser.add_argument("--rasterizer",
                        help="what pskel draws by (default: auto; with --torch compute on a GPU, otherwise cpu)")
    maps = "color,depth,class,point"
    parser.add_argument("--maps", default=maps, help=f"of pskel (default: {maps}, those that native makes)")
    parser.add_argument("--graphics", action="store_true", help="also pskel by --rasterizer graphics, on fewer frames")
    parser.add_argument("--numpy", action="store_true", help="also numpy_splat.py, one frame a round")
    parser.add_argument("--torch", action="store_true", help="also torch_splat.py, on the processor on fewer frames")
    native = parser.add_mutually_exclusive_group()
    native.add_argument("--native-bin", type=file, help="binary of the native peer, instead of building it")
    native.add_argument("--no-native", dest="native", action="store_false", help="leave out the native peer")
    args = parser.parse_args()
    args.pskel = args.pskel.resolve()
    if not args.pskel.is_file():
        parser.error(f"expected pskel (cargo build --release), found none: {args.pskel}")
    return args


def main():
    args = parse_args()
    for name, value in THREADS.items():
        os.environ.setdefault(name, value)
    try:
        if args.work:
            args.work = args.work.resolve()
            args.work.mkdir(parents=True, exist_ok=True)
            compare(args, args.work)
        else:
            with tempfile.TemporaryDirectory(prefix="pskel-peers-") as folder:
                compare(args, Path(folder))
    except (Failure, OSError) as error:
        say(f"error: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
