"""Exports on a Ray cluster: ``python -m pskel.ray export LOGS.. --layout L --out DIR_OR_URL [--workers N]``.

A task opens a log, builds its skeleton, and renders and writes its shards, so builds and renders of different logs overlap. Ray
starts a task again when its worker dies; shards that are complete are then skipped. ``out`` and logs may be URLs of any file
system that fsspec opens.
"""

from __future__ import annotations

import argparse
import json
import logging
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

try:
    import ray
except ImportError as error:
    raise ImportError("pskel.ray needs Ray: pip install 'pskel[ray]'") from error

from . import _remote
from ._build import progress_bar
from ._export import ExportReport, defaults
from ._pskel import Export
from ._types import ExportKeywords, check_names

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["device", "export"]

def device() -> str | None:
    """The UUID of the GPU that Ray assigned to this worker, for ``--device``; ``None`` without one.

    Vulkan ignores ``CUDA_VISIBLE_DEVICES``, so the index that Ray assigns is looked up with nvidia-smi.
    """
    assigned = ray.get_runtime_context().get_accelerator_ids().get("GPU", [])
    if not assigned:
        return None
    if assigned[0].startswith("GPU-"):
        return str(assigned[0])
    query = ["nvidia-smi", "--query-gpu=index,uuid", "--format=csv,noheader"]
    listed = subprocess.run(query, capture_output=True, text=True, check=True).stdout
    uuids = dict(line.split(", ") for line in listed.splitlines())
    return uuids[assigned[0]]


def _export_log(options: dict[str, Any], log: str, shards: list[str], out: str, skeletons: str | None) -> ExportReport:
    """Export shards of one log; runs in a worker."""
    with tempfile.TemporaryDirectory(prefix="pskel-") as scratch:
        local = Path(scratch)
        name = _remote.fetch(log, local / "logs", sensors=True) if _remote.is_remote(log) else log
        folder = local / "out" if _remote.is_remote(out) else Path(out)
        keywords = {**options, "skeletons": skeletons or local / "skeletons"}
        gpu = device()
        if gpu is not None:
            keywords["device"] = gpu
        job = Export([name], folder, keywords)
        report: ExportReport = json.loads(job.run(shards))
        report["failures"] += [{"name": name, "error": error} for name, error in job.failures]
        if _remote.is_remote(out):
            _remote.upload(folder, out, shards)
        return report


def export(
    logs: str | Sequence[str],
    out: str | PathLike[str],
    *,
    layout: str,
    skeletons: str | PathLike[str] | None = None,
    workers: int | None = None,
    num_cpus: float = 1,
    num_gpus: float = 0,
    retries: int = 5,
    progress: bool = False,
    **options: Unpack[ExportKeywords],
) -> ExportReport:
    """Export the condition maps of logs with the workers of a Ray cluster.

    ``logs``, ``layout`` and ``options``: see ``pskel.export``. ``out`` is a folder that all workers share, or
    a URL. ``skeletons`` is a shared folder; without it, each task builds its skeleton in a temporary folder.
    At most ``workers`` logs (default: as many as the cluster has room for) are exported at a time, each with
    ``num_cpus`` and ``num_gpus``. A task is started again up to ``retries`` times when its worker dies. The
    report lists failed logs and shards.
    """
    logs = [logs] if isinstance(logs, str) else list(logs)
    check_names(options, ExportKeywords)
    given = {**defaults(), **options, "layout": layout}
    return _export(logs, given, fspath(out), None if skeletons is None else fspath(skeletons), workers, num_cpus, num_gpus, retries, progress)


def _export(
    logs: list[str],
    given: dict[str, Any],
    out: str,
    skeletons: str | None,
    workers: int | None,
    num_cpus: float,
    num_gpus: float,
    retries: int,
    progress: bool,
) -> ExportReport:
    if not ray.is_initialized():
        ray.init(logging_level=logging.WARNING)
    total: ExportReport = {
        "written": 0, "present": 0, "busy": 0, "samples": 0, "built": 0, "notes": {}, "failures": [], "complete": False,
    }  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="pskel-") as scratch:
        local = Path(scratch)
        copies = {
            log: _remote.fetch(log, local / "logs", sensors=False) if _remote.is_remote(log) else log for log in logs
        }
        folder = local / "out" if _remote.is_remote(out) else Path(out)
        listing = Export([*copies.values()], folder, {**given, "skeletons": local / "none"})
        total["failures"] += [{"name": name, "error": error} for name, error in listing.failures]
        done = _records(out, folder) if _remote.is_remote(out) else set()
        work: dict[str, list[str]] = {}
        for shard, log, _, _ in listing.shards:
            if shard in done:
                total["present"] += 1
            else:
                work.setdefault(_original(log, copies), []).append(shard)
        task = ray.remote(_export_log).options(max_retries=retries, num_cpus=num_cpus, num_gpus=num_gpus)
        cpus: float = ray.cluster_resources().get("CPU", 1)  # type: ignore[no-untyped-call]
        limit = workers or max(1, int(cpus / max(num_cpus, 1e-3)))
        _run(task, work, limit, progress, lambda log, shards: (given, log, shards, out, skeletons), total)
        if _remote.is_remote(out):
            _records(out, folder)
        complete = listing.write_index(folder) if folder.is_dir() else False
        if complete and _remote.is_remote(out):
            system, root = _remote.store(out)
            lists = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
            for file in sorted(lists, key=lambda path: path.name == "index.json"):  # last
                system.put_file(str(file), f"{root}/{file.name}")
        total["complete"] = complete and not total["failures"]
    return total


def _run(task: Any, work: dict[str, list[str]], limit: int, progress: bool, args: Any, total: ExportReport) -> None:
    """Keep ``limit`` tasks running, and add up their reports."""
    waiting = list(work.items())[::-1]
    running: dict[Any, str] = {}
    bar = None
    if progress and (tqdm := progress_bar()):
        bar = tqdm(total=len(work), unit="log")
    while waiting or running:
        while waiting and len(running) < limit:
            log, shards = waiting.pop()
            running[task.remote(*args(log, shards))] = log
        finished, _ = ray.wait(list(running), num_returns=1)
        log = running.pop(finished[0])
        try:
            report: ExportReport = ray.get(finished[0])
        except ray.exceptions.RayError as error:
            total["failures"].append({"name": log, "error": str(error)})
        else:
            _add(total, report)
        if bar is not None:
            bar.update()
            bar.set_postfix_str(f"{total['samples']} samples, {len(total['failures'])} failures")
    if bar is not None:
        bar.close()


def _add(total: ExportReport, report: ExportReport) -> None:
    total["written"] += report["written"]
    total["present"] += report["present"]
    total["busy"] += report["busy"]
    total["samples"] += report["samples"]
    total["built"] += report["built"]
    total["failures"] += report["failures"]
    for kind, count in report["notes"].items():
        total["notes"][kind] = total["notes"].get(kind, 0) + count


def _records(out: str, folder: Path) -> set[str]:
    """Copy the records of a remote export; returns the names of its shards."""
    system, root = _remote.store(out)
    names = set()
    if system.exists(f"{root}/shards"):
        (folder / "shards").mkdir(parents=True, exist_ok=True)
        for path in system.ls(f"{root}/shards", detail=False):
            name = path.rsplit("/", 1)[-1]
            system.get_file(path, str(folder / "shards" / name))
            names.add(name.removesuffix(".json"))
    return names


def _original(log: str, copies: dict[str, str]) -> str:
    """Name of a listed log in the place where it was found."""
    for given, copy in copies.items():
        if given != copy and _remote.split(log)[:2] == _remote.split(copy)[:2]:
            kind, path, _ = _remote.split(given)
            return f"{kind}:{path}{_remote.split(log)[2]}"
    return log


def _options() -> dict[str, Any]:
    """Options of the command line: parsers of their values by name; ``None`` for flags."""
    parsers: dict[str, Any] = {"layout": str, "workers": int, "num_cpus": float, "num_gpus": float, "retries": int}
    for name, kind in ExportKeywords.__annotations__.items():
        text = kind if isinstance(kind, str) else kind.__forward_arg__
        if text == "bool":
            parsers[name] = None
        elif text.startswith("tuple"):
            parsers[name] = lambda value: tuple(int(number) for number in re.split(r"\.\.|/", value))
        elif text.startswith("Sequence[int]"):
            parsers[name] = lambda value: [int(side) for side in value.split("x")]
        elif text.startswith("Sequence"):
            parsers[name] = lambda value: value.split(",")
        else:
            parsers[name] = {"int": int, "float": float}.get(text.split(" ")[0], str)
    return parsers


def main(argv: list[str]) -> int:
    """Run ``python -m pskel.ray export ..``."""
    parser = argparse.ArgumentParser("python -m pskel.ray", description="Options as of pskel.export and pskel.ray.export.")
    parser.add_argument("command", choices=["export"])
    parser.add_argument("logs", nargs="+")
    parser.add_argument("--out", required=True)
    parser.add_argument("--skeletons")
    for name, kind in _options().items():
        option = "--" + name.replace("_", "-")
        if kind is None:
            parser.add_argument(option, action=argparse.BooleanOptionalAction, default=argparse.SUPPRESS)
        else:
            parser.add_argument(option, type=kind, default=argparse.SUPPRESS, required=name == "layout")
    given = vars(parser.parse_intermixed_args(argv))
    del given["command"]
    report = export(given.pop("logs"), given.pop("out"), progress=True, **given)
    print(json.dumps(report, indent=1))
    return 1 if report["failures"] else 0


if __name__ == "__main__":
    from pskel.ray import main as imported  # workers find the functions of a module, and not those of __main__

    sys.exit(imported(sys.argv[1:]))
