#!/usr/bin/env python3
"""Builds the skeleton of a location from many logs, without and with interruptions, and prints what it needs.

    ci/many_logs.py [--logs N] [--kills N] [--frames N] [--size HxW] [--seed S] [--towns DIR] [--pskel FILE]

The logs are synthetic towns with consecutive seeds, which share a location. They are written to --towns, unless they are
there already. The first build runs through, the second one
is killed at random moments (SIGKILL) and continued with --resume. Prints time, peak memory and peak disk space of the
first one beside the estimate of the command, and exits with 1 if the skeletons differ or if the disk space is exceeded.
"""

import argparse
import random
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
UNITS = {"MiB": 2**20, "GiB": 2**30, "TiB": 2**40}


def size_of(folder):
    """Returns the size of all files below a folder, bytes."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except FileNotFoundError:
            pass  # removed meanwhile
    return total


def estimates(text):
    """Returns the points, the disk space and the memory that the command expects to need, bytes."""
    found = re.search(r"about ([\d.]+) million points.*at most ([\d.]+) (\w+) of disk.*end; ([\d.]+) (\w+) of memory", text)
    points, disk, disk_unit, memory, memory_unit = found.groups()
    return float(points) * 1e6, float(disk) * UNITS[disk_unit], float(memory) * UNITS[memory_unit]


def written_towns(args, folder):
    """Writes the towns that are missing in a folder; returns the logs."""
    logs = []
    for seed in range(1, args.logs + 1):
        town = folder.resolve() / f"{args.size}-{args.frames}-{seed}"
        if not town.is_dir():
            options = f"seed={seed},frames={args.frames},size={args.size}"
            subprocess.run([args.pskel, "town", options, "--out", town], check=True, capture_output=True)
        logs.append(f"nuscenes:{town}")
    return logs


class DiskPeak(threading.Thread):
    """Measures the largest size of a folder while something runs."""

    def __init__(self, folder):
        super().__init__(daemon=True)
        self.folder, self.peak, self.ended = folder, 0, threading.Event()

    def run(self):
        while not self.ended.wait(0.05):
            self.peak = max(self.peak, size_of(self.folder))


def whole_build(command, folder):
    """Builds without interruption and prints its needs; returns the time, seconds, and whether the disk space sufficed."""
    folder.mkdir()
    disk, start = DiskPeak(folder), time.monotonic()
    disk.start()
    with open(folder / "out.txt", "w+") as out, open(folder / "err.txt", "w+") as err:
        process = subprocess.Popen(command, cwd=folder, stdout=out, stderr=err)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    seconds = time.monotonic() - start
    disk.ended.set()
    said, errors = [(folder / name).read_text() for name in ("out.txt", "err.txt")]
    for name in ("out.txt", "err.txt"):
        (folder / name).unlink()
    if process.returncode != 0:
        sys.exit(errors)
    memory = usage.ru_maxrss * 1024  # of this process alone
    points, disk_estimate, memory_estimate = estimates(errors)
    print(said.strip().splitlines()[-1][-300:])
    print(f"{seconds:.1f} s, {points / 1e6:.1f} million points; disk {disk.peak / 2**20:.0f} MiB (at most "
          f"{disk_estimate / 2**20:.0f}), {size_of(folder) / 2**20:.0f} at the end; memory {memory / 2**20:.0f} MiB "
          f"(at most {memory_estimate / 2**20:.0f} beyond the logs)")
    return seconds, disk.peak <= disk_estimate


def killed_build(command, folder, seconds, kills, random_moment):
    """Builds with interruptions; returns their number."""
    folder.mkdir()
    killed = 0
    while True:
        resume = ["--resume"] if (folder / "sk.partial/checkpoint.json").is_file() else []
        process = subprocess.Popen([*command, *resume], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            if killed < kills:
                process.wait(random_moment.uniform(0.3, 2.0) * seconds / kills)
            elif process.wait() != 0:
                sys.exit(process.stderr.read())
            return killed
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            killed += 1


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--size", default="57x100")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--towns", type=Path)
    parser.add_argument("--pskel", default=str(ROOT / "target/release/pskel"))
    args = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="pskel-many-"))
    try:
        logs = written_towns(args, args.towns or work / "towns")
        command = [args.pskel, "build", *logs, "--out", "sk"]
        seconds, holds = whole_build(command, work / "whole")
        killed = killed_build(command, work / "killed", seconds, args.kills, random.Random(args.seed))
        differs = subprocess.run(["diff", "-rq", work / "whole", work / "killed"], capture_output=True, text=True).stdout
    finally:
        shutil.rmtree(work)
    print(f"killed {killed} times: {'other bytes: ' + differs if differs else 'the same bytes'}")
    if differs or not holds or killed < args.kills:
        sys.exit(1)


if __name__ == "__main__":
    main()
