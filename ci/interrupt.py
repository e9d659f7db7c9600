#!/usr/bin/env python3
"""Interrupts pskel at random moments, starts it twice at once, lets the disk run full, and checks the remaining files and
processes.

    ci/interrupt.py [--kills N] [--terms N] [--races N] [--disks N] [--seed S] [--pskel FILE]

A trial runs a command in a new folder and sends SIGKILL or SIGTERM at a random moment of its run. Then the command runs
again, with --resume if it has that option. Checks of each trial:
- SIGTERM: exit code 143 (0 if the command had already finished, the signal itself in its first milliseconds), and no
  temporary file except the checkpoint of a build;
- no process of the trial remains, including planners;
- the second run succeeds, and its output equals that of an uninterrupted run, without temporary files or locks.
A race starts a command twice at once on one folder: one succeeds, the other succeeds as well or reports that a process is
at work, and the folder has the bytes of a single run.
A full disk is a limit on the size of files, below that of the largest one: the command fails with a message and leaves
no temporary file; without the limit it succeeds afterwards, with the bytes of a single run.

The commands are build, render, simulate (also with --mcap), generate (also with --dataset), protocol, export, town,
templates and convert on a small town. Prints one line per command, and exits with 1 if a check failed.
"""

import argparse
import hashlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TOWN = "town:seed=5,frames=5,size=57x100"
LOG = "nuscenes:../shared/town"
SKELETON = "../shared/skeleton"
MAPS = f"{LOG} --skeleton {SKELETON} --out out --maps color,depth --size 57x100"
PLANNER = f"{sys.executable} {ROOT / 'examples/planner.py'}"

# Name, arguments (by spaces, but the last one), last argument, whether it resumes.
COMMANDS = [
    ("build", f"build {LOG} --checkpoint 1 --out out", None, True),
    ("render", f"render {MAPS}", None, False),
    ("simulate", f"simulate {MAPS} --ego external --actors idm --steps 20 --planner", PLANNER, True),
    ("generate", f"generate {MAPS} --every 1", None, True),
    ("mcap", f"simulate {MAPS} --ego lane_change --actors idm --steps 10 --mcap out.mcap", None, True),
    ("dataset", f"generate {MAPS} --every 1 --generator fill --window 2 --dataset copy", None, True),
    ("protocol", f"protocol nuscenes-val {LOG} --other-logs --parts 2hz --generated-only --generator fill --window 2 "
                 "--skeletons sks --out out --maps color,depth,class --size 57x100", None, False),
    ("export", f"export {LOG} --layout frames --shard-frames 1 --skeletons sks --out out --maps color,depth --size 57x100",
     None, False),
    ("shards", f"export {LOG} town:seed=6,frames=5,size=57x100 --layout webdataset --shard-frames 2 --skeletons sks --out out --maps depth --size 57x100",
     None, False),
    ("town", "town seed=5,frames=3,size=57x100 --out out", None, False),
    ("templates", f"templates {SKELETON} --min-points 1 --out out", None, False),
    ("convert", f"convert {SKELETON} --out out", None, False),
]


class Failure(Exception):
    """A failed check: the expected and the actual result."""


def expect(condition, text):
    if not condition:
        raise Failure(text)


def tree(folder):
    """Returns the hashes of all files below a folder, and the targets of links, which may have the folder in their text."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = os.path.relpath(os.path.realpath(path), os.path.realpath(folder))
        elif path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def difference(found, expected):
    names = sorted(set(found) ^ set(expected)) or [name for name in expected if found[name] != expected[name]]
    return ", ".join(names[:5])


def processes(mark):
    """Returns the live processes of a trial, identified by an environment variable."""
    alive = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            environment = (entry / "environ").read_bytes()
            state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            continue  # ended meanwhile
        if mark.encode() in environment and state not in "ZX":
            alive.append(entry.name)
    return alive


class Trials:
    """Runs trials of one command in separate folders below `work`."""

    def __init__(self, work, pskel, command):
        self.work, self.pskel = work, pskel
        self.name, arguments, last, self.resumes = command
        self.arguments = arguments.split() + ([last] if last else [])
        self.number = 0

    def start(self, folder, *extra, file_bytes=None):
        self.mark = f"PSKEL_TRIAL={folder}"
        name, _, value = self.mark.partition("=")
        limit = file_bytes and (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes)))
        return subprocess.Popen([self.pskel, *self.arguments, *extra], cwd=folder, env={**os.environ, name: value},
                                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                preexec_fn=limit)

    def folder(self):
        self.number += 1
        folder = self.work / f"{self.name}-{self.number}"
        folder.mkdir()
        return folder

    def reference(self):
        """Measures output and duration of an uninterrupted run."""
        folder = self.folder()
        start = time.monotonic()
        process = self.start(folder)
        error = process.communicate()[1]
        expect(process.returncode == 0, f"expected the reference of {self.name} to succeed, found {error}")
        self.seconds, self.expected = time.monotonic() - start, tree(folder)
        files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
        self.largest = max(path.stat().st_size for path in files)

    def left_nothing(self, folder, keeps=()):
        for _ in range(40):
            alive = processes(self.mark)
            if not alive:
                break
            time.sleep(0.05)
        expect(not alive, f"expected no process, found {alive}")
        left = [name for name in self.temporary(folder) if not name.startswith(tuple(keeps))]
        expect(not left, f"expected no temporary name, found {left[:5]}")

    @staticmethod
    def temporary(folder):
        names = [str(path.relative_to(folder)) for path in folder.rglob("*")]
        ends = (".pskel", ".pskel-part", ".partial", "/lock")
        return [n for n in names if n.endswith(ends) or ".partial/" in n or ".unfinished/" in n]

    def interrupt(self, number, rng):
        """Returns whether the signal arrived before the end of the run."""
        folder = self.folder()
        process = self.start(folder)
        time.sleep(rng.random() * 1.05 * self.seconds)
        process.send_signal(number)
        error = process.communicate()[1]
        was_running = process.returncode != 0
        if was_running:
            # The kernel ends a process that has not installed its handlers yet.
            codes = [-number] + [128 + number] * (number == signal.SIGTERM)
            expect(process.returncode in codes, f"expected exit code {codes}, found {process.returncode}: {error}")
        if number == signal.SIGTERM:
            self.left_nothing(folder, keeps=("out.partial",) if self.name == "build" else ())
        else:
            self.left_nothing_running(folder)
        extra = ["--resume"] if self.resumes and rng.random() < 0.75 else []
        self.finish(folder, *extra)
        return was_running

    def fill(self, rng):
        """Returns whether the limit stopped the run."""
        folder = self.folder()
        process = self.start(folder, file_bytes=max(1, int(rng.random() * self.largest)))
        error = process.communicate()[1]
        stopped = process.returncode != 0
        expect(process.returncode in (0, 1), f"expected exit code 0 or 1, found {process.returncode}: {error}")
        expect(not stopped or "File too large" in error, f"expected an error that names the cause, found {error}")
        self.left_nothing(folder, keeps=("out.partial",) if self.name == "build" else ())
        self.finish(folder)
        return stopped

    def finish(self, folder, *extra):
        """Runs the command again after a run that was ended: it succeeds with the same bytes."""
        process = self.start(folder, *extra)
        error = process.communicate()[1]
        expect(process.returncode == 0, f"expected the next run to succeed {extra}, found {error}")
        self.left_nothing(folder)
        found = tree(folder)
        expect(found == self.expected, f"expected the same bytes, found others: {difference(found, self.expected)}")
        shutil.rmtree(folder)

    def left_nothing_running(self, folder):
        for _ in range(60):
            alive = processes(self.mark)
            if not alive:
                return
            time.sleep(0.05)
        raise Failure(f"expected no process, found {alive}")

    def race(self, rng):
        """Returns whether one of the two was refused."""
        folder = self.folder()
        first = self.start(folder)
        time.sleep(rng.random() * 0.2 * self.seconds)
        pair = [first, self.start(folder)]
        errors = [process.communicate()[1] for process in pair]
        codes = [process.returncode for process in pair]
        expect(0 in codes, f"expected one to succeed, found {errors}")
        for code, error in zip(codes, errors):
            said = "output is locked by" in error
            expect(code == 0 or (code == 1 and said), f"expected a refusal that says why, found {code}: {error}")
        self.left_nothing(folder)
        found = tree(folder)
        expect(found == self.expected, f"expected the same bytes, found others: {difference(found, self.expected)}")
        shutil.rmtree(folder)
        return codes != [0, 0]


def prepare(work, pskel):
    """Writes the inputs of the commands."""
    shared = work / "shared"
    shared.mkdir()
    for arguments in ("town seed=5,frames=5,size=57x100 --out town", "build nuscenes:town --out skeleton"):
        done = subprocess.run([pskel, *arguments.split()], cwd=shared, capture_output=True, text=True, check=False)
        expect(done.returncode == 0, f"expected {arguments} to succeed, found {done.stderr}")


def parse_args():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=39, help="trials with SIGKILL, over all commands (default 39)")
    parser.add_argument("--terms", type=int, default=39, help="trials with SIGTERM (default 39)")
    parser.add_argument("--races", type=int, default=26, help="races (default 26)")
    parser.add_argument("--disks", type=int, default=26, help="full disks (default 26)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="names of commands, by commas (default: all)")
    parser.add_argument("--pskel", type=Path, default=ROOT / "target/release/pskel")
    return parser.parse_args()


def share(total, index):
    """Returns the number of trials of a command."""
    return total * (index + 1) // len(COMMANDS) - total * index // len(COMMANDS)


def main():
    args = parse_args()
    pskel, rng, run, failures = args.pskel.resolve(), random.Random(args.seed), 0, 0
    only = args.only.split(",") if args.only else [name for name, *_ in COMMANDS]
    print("| command | seconds | SIGKILL | while running | SIGTERM | while running | races | refused | full disks | stopped | failed |")
    print("|---|---|---|---|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory(prefix="pskel-interrupt-") as work:
        work = Path(work)
        prepare(work, pskel)
        for index, command in enumerate(COMMANDS):
            if command[0] not in only:
                continue
            trials = Trials(work, pskel, command)
            trials.reference()
            plan = [(kind, share(count, index)) for kind, count in
                    (("kill", args.kills), ("term", args.terms), ("race", args.races), ("disk", args.disks))]
            counts, failed = [], 0
            for kind, count in plan:
                hits = 0
                for _ in range(count):
                    try:
                        hits += {
                            "kill": lambda: trials.interrupt(signal.SIGKILL, rng),
                            "term": lambda: trials.interrupt(signal.SIGTERM, rng),
                            "race": lambda: trials.race(rng),
                            "disk": lambda: trials.fill(rng),
                        }[kind]()
                    except Failure as failure:
                        failed += 1
                        print(f"interrupt: {command[0]}, {kind}: {failure}", file=sys.stderr, flush=True)
                counts += [count, hits]
            run, failures = run + sum(count for _, count in plan), failures + failed
            cells = [command[0], f"{trials.seconds:.2f}", *counts, failed]
            print("| " + " | ".join(map(str, cells)) + " |", flush=True)
    print(f"{run} trials, {failures} failed")
    return 1 if failures else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Failure as failure:
        print(f"interrupt: {failure}", file=sys.stderr)
        sys.exit(1)
