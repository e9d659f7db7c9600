"""The output folder of a training: losses, scores, pictures, TensorBoard's events and weights."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from .. import _whole
from .errors import CheckpointError, TrainError

__all__ = ["Outputs", "Table", "claim_folder", "stacked", "write_whole"]

MARKER = "training.json"
_OWN = re.compile(
    r"training\.json|loss\.csv|scores\.csv|tb|validation|weights\.safetensors|checkpoint-\d+|"
    r"\.lock|lost\+found|\..*\.partial"
)


def claim_folder(folder: Path, *, resume: bool) -> BinaryIO:
    """Create the folder, or check that it is a training to resume; returns its lock, which is held while it is open.

    Raises ``TrainError`` for a folder with other content, with a training (without ``resume``), or in use.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = sorted(path.name for path in folder.iterdir())
        lock = open(folder / ".lock", "a+b")
    except OSError as error:
        raise TrainError(f"the output folder cannot be written: {error.strerror}: {folder}") from error
    try:
        # A lock of this process alone: workers, which are forked, outlive a killed process for seconds.
        fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.seek(0)
        owner = lock.read().decode(errors="replace").strip()
        lock.close()
        raise TrainError(f"the output folder is in use by process {owner or 'unknown'}: {folder}") from None
    foreign = [name for name in names if not _OWN.fullmatch(name)]
    is_training = (folder / MARKER).is_file()
    problem = None
    if foreign:
        problem = f"expected an empty folder or a training, found {foreign[0]}: {folder}"
    elif is_training and not resume:
        problem = f"the folder has a training: pass --resume to continue it, or choose another --out: {folder}"
    if problem is not None:
        lock.close()
        if not names:
            (folder / ".lock").unlink(missing_ok=True)
        raise TrainError(problem)
    lock.truncate(0)
    lock.write(str(os.getpid()).encode())
    lock.flush()
    return lock


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, then rename it. Raises ``CheckpointError`` if it cannot be written."""
    try:
        _whole.write_whole(path, content)
    except OSError as error:
        raise CheckpointError(f"the file cannot be written: {error.strerror}: {path}") from error


class Table:
    """A CSV file with a row per step. New columns are added at the right."""

    def __init__(self, path: Path, steps: int) -> None:
        """Open the table, with the rows of steps up to ``steps``."""
        self._path = path
        self.last = 0
        self._columns: list[str] = ["step"]
        rows: list[dict[str, str]] = []
        if path.is_file():
            with open(path, newline="") as file:
                reader = csv.DictReader(file)
                self._columns = list(reader.fieldnames or self._columns)
                rows = [row for row in reader if _is_row(row) and int(row["step"]) <= steps]
        self.last = max((int(row["step"]) for row in rows), default=0)
        self._rewrite(rows)

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        text = io.StringIO()
        writer = csv.DictWriter(text, self._columns, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_whole(self._path, text.getvalue().encode())

    def add(self, step: int, numbers: Mapping[str, float]) -> None:
        """Append a row. Raises ``CheckpointError`` if it cannot be written."""
        if new := [name for name in numbers if name not in self._columns]:
            with open(self._path, newline="") as file:
                rows = list(csv.DictReader(file))
            self._columns += new
            self._rewrite(rows)
        self.last = step
        row = {"step": str(step), **{name: repr(float(value)) for name, value in numbers.items()}}
        line = ",".join(row.get(name, "") for name in self._columns) + "\n"
        try:
            with open(self._path, "a") as file:
                file.write(line)
        except OSError as error:
            raise CheckpointError(f"the table cannot be written: {error.strerror}: {self._path}") from error


def _is_row(row: Mapping[str, str | None]) -> bool:
    """Return whether a row is complete: a killed process may leave a part of one."""
    return all(value is not None for value in row.values()) and (row.get("step") or "").isdecimal()


class Outputs:
    """Files of the main process. The other processes have none."""

    def __init__(self, folder: Path, config: Mapping[str, Any], steps: int) -> None:
        self.folder = folder
        write_whole(folder / MARKER, json.dumps(config, indent=1).encode())
        self.losses = Table(folder / "loss.csv", steps)
        self._scores = Table(folder / "scores.csv", steps)
        self._board = _board(folder / "tb", steps)
        (folder / "validation").mkdir(exist_ok=True)

    def has_scores(self, step: int) -> bool:
        """Return whether the scores after a step are there."""
        return self._scores.last == step

    @property
    def has_board(self) -> bool:
        """Whether TensorBoard is installed."""
        return self._board is not None

    @contextmanager
    def _events(self) -> Iterator[None]:
        """Turn errors of TensorBoard's files into one line."""
        try:
            yield
        except OSError as error:
            raise CheckpointError(f"the events cannot be written: {error.strerror}: {self.folder / 'tb'}") from error

    def _show(self, step: int, numbers: Mapping[str, float]) -> None:
        if self._board is not None:
            with self._events():
                for name, value in numbers.items():
                    self._board.add_scalar(name.replace(".", "/"), value, step)

    def loss(self, step: int, numbers: Mapping[str, float]) -> None:
        """Add the losses of a step."""
        self.losses.add(step, numbers)
        self._show(step, numbers)

    def validation(self, step: int, scores: Mapping[str, float], picture: Tensor | None) -> None:
        """Add mean scores of held-out clips, and a picture ``uint8 [3, H, W]``."""
        if scores:
            self._scores.add(step, scores)
            self._show(step, {f"validation.{name}": value for name, value in scores.items()})
        if picture is not None:
            from .data.images import pillow

            content = io.BytesIO()
            pillow().fromarray(picture.permute(1, 2, 0).contiguous().numpy()).save(content, "PNG")
            write_whole(self.folder / "validation" / f"{step}.png", content.getvalue())
            if self._board is not None:
                with self._events():
                    self._board.add_image("validation/pictures", picture, step)
        if self._board is not None:
            with self._events():
                self._board.flush()

    def weights(self, tensors: Mapping[str, Tensor], header: Mapping[str, str]) -> None:
        """Write ``weights.safetensors``. Raises ``CheckpointError`` if it cannot be written."""
        from safetensors.torch import save_file

        path = self.folder / "weights.safetensors"
        partial = path.with_name(f".{path.name}.partial")
        try:
            save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, partial, dict(header))
            with open(partial, "rb") as file:
                os.fsync(file.fileno())
            os.chmod(partial, (self.folder / MARKER).stat().st_mode)  # safetensors writes files for their owner alone
            os.replace(partial, path)
        except Exception as error:  # safetensors has an error type of its own
            partial.unlink(missing_ok=True)
            raise CheckpointError(f"the weights cannot be written: {_reason(error)}: {path}") from error

    def close(self) -> None:
        """Write everything that is pending."""
        if self._board is not None:
            try:
                self._board.close()
            except OSError:
                pass  # the events alone are incomplete


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error).splitlines()[0]


def _board(folder: Path, steps: int) -> Any:
    """Return TensorBoard's writer, ``None`` if it is not installed. Events of later steps are hidden."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    writer: Any = SummaryWriter(os.fspath(folder), purge_step=steps + 1 if steps else None)
    return writer


def stacked(pictures: list[Tensor]) -> Tensor | None:
    """Return pictures ``[rows, 3, H, W]`` of clips in a picture ``[3, H, W]``: clips side by side, rows downwards."""
    if not pictures:
        return None
    columns = [torch.cat(list(rows.cpu()), dim=1) for rows in pictures]
    height = max(column.shape[1] for column in columns)
    padded = [torch.nn.functional.pad(column, (0, 0, 0, height - column.shape[1])) for column in columns]
    return torch.cat(padded, dim=2)
