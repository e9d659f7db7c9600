"""Checkpoints, from which a training continues with the same losses.

A checkpoint is the folder ``checkpoint-STEP`` with ``checkpoint.json`` (step, configuration) and ``rank-0.pt``
(modules, moments of the optimizers, averages, state of the task). Of sharded modules each process writes its part,
``rank-R.pt``. The folder is written under a temporary name and renamed, so that it is complete or not there. Random
numbers depend on seed and step: there is no state of them.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor, nn

from .errors import CheckpointError, first_line
from .optimizer import load_moments, moments
from .parallel import Processes, local
from .players import Players
from .task import Task

__all__ = [
    "compare",
    "last_checkpoint",
    "load_modules",
    "load_players",
    "read_state",
    "remove_partial",
    "save_checkpoint",
]

FORMAT = 1
KEPT = 2
_NAME = re.compile(r"checkpoint-(\d+)")
_FREE_KEYS = {"train.checkpoint", "train.validate", "train.workers", "train.accumulate", "data.cache", "data.skeletons"}
_FREE_KEYS |= {"data.validation_clips", "data.validation_pictures", "data.rasterizer"}
"""Keys that do not change losses. ``accumulate`` is compared with the number of processes."""


def _path(folder: Path, step: int) -> Path:
    return folder / f"checkpoint-{step}"


def _steps(folder: Path) -> list[int]:
    """Return the steps of the complete checkpoints in a folder."""
    found = [(match, path) for path in folder.iterdir() if (match := _NAME.fullmatch(path.name))]
    return sorted(int(match[1]) for match, path in found if (path / "checkpoint.json").is_file())


def last_checkpoint(folder: Path) -> Path | None:
    """Return the last complete checkpoint in a folder, ``None`` without one."""
    steps = _steps(folder) if folder.is_dir() else []
    return _path(folder, steps[-1]) if steps else None


def remove_partial(folder: Path) -> None:
    """Remove what a killed process left."""
    for path in folder.glob(".*.partial"):
        shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)


class _Writer:
    """A file that remembers why writing failed: PyTorch reports another error."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.error: OSError | None = None

    def write(self, content: Any) -> int:
        try:
            return self._file.write(content)
        except OSError as error:
            self.error = error
            raise

    def flush(self) -> None:
        self._file.flush()


def _write_state(path: Path, state: Mapping[str, Any]) -> None:
    with open(path, "wb", buffering=0) as file:
        writer = _Writer(file)
        try:
            torch.save(state, writer)  # type: ignore[arg-type]
        except (OSError, RuntimeError) as error:
            raise writer.error or error from None
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _state(task: Task, players: Players) -> dict[str, Any]:
    def part(tensors: Mapping[str, Any]) -> dict[str, Any]:
        return {name: local(value).detach() if isinstance(value, Tensor) else value for name, value in tensors.items()}

    return {
        "modules": {entry.player.name: part(entry.module.state_dict()) for entry in players.entries},
        "moments": {entry.player.name: moments(entry.optimizer) for entry in players.entries},
        "ema": None if players.ema is None else dict(players.ema.averages),
        "task": task.state(),
    }


def save_checkpoint(
    folder: Path, step: int, config: Mapping[str, Any], task: Task, players: Players, processes: Processes
) -> None:
    """Write a checkpoint, and remove all but the last two. All processes have to call it.

    Raises ``CheckpointError`` in all of them if one cannot write; the last checkpoint is unchanged.
    """
    partial = folder / f".checkpoint-{step}.partial"
    is_sharded = any(entry.is_sharded for entry in players.entries)
    failure = None
    try:
        partial.mkdir(exist_ok=True)
        if is_sharded or processes.is_main:
            _write_state(partial / f"rank-{processes.rank}.pt", _state(task, players))
    except (OSError, RuntimeError) as error:
        failure = getattr(error, "strerror", None) or first_line(error)
    failures = [text for text in processes.gather(failure) if text is not None]
    if processes.is_main and not failures:
        try:
            _finish(folder, partial, step, config)
        except OSError as error:
            failures = [error.strerror or first_line(error)]
    with processes.agreed():
        if failures and processes.is_main:
            shutil.rmtree(partial, ignore_errors=True)
            last = last_checkpoint(folder)
            kept = "there is no earlier one" if last is None else f"--resume continues from {last.name}"
            raise CheckpointError(f"the checkpoint cannot be written: {failures[0]}: {_path(folder, step)}; {kept}")


def _finish(folder: Path, partial: Path, step: int, config: Mapping[str, Any]) -> None:
    about = {"format": FORMAT, "step": step, "torch": torch.__version__, "config": config}
    with open(partial / "checkpoint.json", "w") as file:
        json.dump(about, file, indent=1)
        file.flush()
        os.fsync(file.fileno())
    _sync_folder(partial)
    target = _path(folder, step)
    shutil.rmtree(target, ignore_errors=True)  # of a training that went on from an earlier one
    os.rename(partial, target)
    _sync_folder(folder)
    for old in _steps(folder)[:-KEPT]:
        shutil.rmtree(_path(folder, old), ignore_errors=True)


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Return the values of nested mappings and lists of lists by keys such as ``data.frames`` and ``clips.3``."""
    if isinstance(value, list) and value and all(isinstance(each, list) for each in value):
        return {f"{prefix}{number}": each for number, each in enumerate(value)}
    if isinstance(value, Mapping):
        return {k: v for key, each in value.items() for k, v in _flat(each, f"{prefix}{key}.").items()}
    return {prefix.rstrip("."): value}


def compare(ours: Mapping[str, Any], path: Path) -> int:
    """Check that a checkpoint is of this configuration; returns its step.

    Raises ``CheckpointError``, which names the first differing key, and for another file.
    """
    source = path / "checkpoint.json"
    try:
        about = json.loads(source.read_bytes())
        step, theirs, version = int(about["step"]), about["config"], about["format"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"expected a checkpoint, found {first_line(error)}: {source}") from error
    if version != FORMAT:
        raise CheckpointError(f"expected a checkpoint of format {FORMAT}, found {version}: {source}")
    one, other = _flat(ours), _flat(theirs)
    free = set(_FREE_KEYS)
    if one.get("train.schedule") == "constant":
        free.add("train.steps")
    for key in sorted(one.keys() | other.keys()):
        if key not in free and one.get(key) != other.get(key):
            found, expected = (json.dumps(each.get(key))[:80] for each in (other, one))
            raise CheckpointError(
                f"the checkpoint has another configuration: {key} is {found} there, {expected} here: {path}"
            )
    return step


def read_state(path: Path, processes: Processes, *, sharded: bool) -> dict[str, Any]:
    """Read what this process needs of a checkpoint, to the CPU. Raises ``CheckpointError``, which names the file."""
    file = path / f"rank-{processes.rank if sharded else 0}.pt"
    try:
        state: dict[str, Any] = torch.load(file, map_location="cpu", weights_only=True)
        return state
    except Exception as error:  # of many kinds, by what the file is
        raise CheckpointError(f"the checkpoint cannot be read: {first_line(error)}: {file}") from error


@torch.no_grad()
def load_modules(modules: Mapping[str, nn.Module], state: Mapping[str, Any], *, buffers_only: bool = False) -> None:
    """Restore parameters and buffers. Raises ``CheckpointError`` if they are of another module."""
    for name, module in modules.items():
        saved, present = state["modules"].get(name, {}), module.state_dict()
        if saved.keys() != present.keys():
            key = sorted(saved.keys() ^ present.keys())[0]
            raise CheckpointError(f"the checkpoint is of another module {name}: they differ in {key}")
        buffers = {key for key, _ in module.named_buffers()}
        for key, value in present.items():
            if not isinstance(value, Tensor) or (buffers_only and key not in buffers):
                continue
            if saved[key].shape != local(value).shape:
                shapes = f"{list(saved[key].shape)} there, {list(local(value).shape)} here"
                raise CheckpointError(f"the checkpoint is of another module {name}: {key} is {shapes}")
            local(value).copy_(saved[key])


def load_players(players: Players, state: Mapping[str, Any], device: torch.device) -> None:
    """Restore moments and averages, and the parts of sharded modules."""
    load_modules({entry.player.name: entry.module for entry in players.entries}, state)
    for entry in players.entries:
        load_moments(entry.optimizer, state["moments"][entry.player.name], device)
    if players.ema is not None:
        players.ema.load(state["ema"])
