"""Readers of a log's frames, and the clips in them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..clip import Clip
from ..errors import DataError

__all__ = ["ClipSet", "FrameReader", "Frames", "Skip", "frames_apart", "is_steady"]

_RATE_TOLERANCE = 0.05
"""Relative difference between the rate of a log and a multiple of the rate of clips; recorded times are not exact."""


class Skip(Exception):
    """A clip is left out. The text says why."""


class Frames(NamedTuple):
    """L frames of V cameras, with the fields of ``Clip``."""

    color: Tensor
    bins: Tensor
    boxes: Tensor
    map: Tensor
    images: Tensor
    cameras: Tensor
    global_from_ego: npt.NDArray[np.float64]
    t_us: npt.NDArray[np.int64]
    original_sizes: npt.NDArray[np.int64]
    captions: tuple[tuple[str, ...], ...]


class FrameReader(ABC):
    """Reads frames of a log or its variant: moved, or with degraded assets."""

    log: str
    """Name of the log."""
    variant: int = 0
    source: str
    """File or log, for messages."""
    names: tuple[str, ...]
    """Channels of the cameras."""
    hz: float
    """Rate of the frames, per second; 0 if it is not known."""
    runs: Sequence[range]
    """Numbers of frames that follow each other without a gap."""
    recipe: Mapping[str, Any]
    times_us: npt.NDArray[np.int64] | None = None
    """Times of all frames, if they are known before reading."""
    captions: Sequence[Sequence[str]] | None = None
    """Captions of all frames and cameras; ``None`` without any, and if they are read with their frames."""

    @abstractmethod
    def read(self, frames: Sequence[int], views: Sequence[int]) -> Frames:
        """Read frames of cameras, by their numbers in ``names``. Raises ``Skip`` or ``DataError``."""

    @abstractmethod
    def motion(self, before: int, after: int) -> npt.NDArray[np.float32]:
        """Return the ego motion ``[3]`` from one frame to another, see ``Clip.action``."""

    def captions_of(self, frames: Sequence[int], views: Sequence[int]) -> tuple[tuple[str, ...], ...]:
        """Return the captions of frames and cameras; empty texts without."""
        texts = self.captions
        return tuple(tuple("" if texts is None else texts[frame][view] for view in views) for frame in frames)

    @property
    def label(self) -> str:
        """Log and variant."""
        return f"{self.log}-{self.variant}" if self.variant else self.log


@dataclass(frozen=True)
class ClipSet:
    """The clips of a log: L frames that are ``step`` apart, beginning every ``stride`` frames."""

    reader: FrameReader
    runs: tuple[tuple[int, ...], ...]
    """Frames of which clips are taken, without gaps in each run."""
    frames: int
    step: int
    stride: int
    views: tuple[int, ...]
    hz: float | None
    """Rate that was asked for."""

    @classmethod
    def create(
        cls,
        reader: FrameReader,
        *,
        frames: int,
        every: int | None = None,
        hz: float | None = None,
        stride: int = 1,
        cameras: Sequence[str] | None = None,
        hold_out: int = 0,
        held_out: bool = False,
    ) -> ClipSet:
        """Choose the clips of a log.

        With ``hold_out`` N, frames N-1, 2N-1 .. are left out; with ``held_out`` only those are taken, at the spacing
        that is nearest to the others'. Raises ``DataError`` for a camera that the reader does not have, and a rate that
        does not divide the reader's.
        """
        chosen = [[f for f in run if not hold_out or ((f + 1) % hold_out == 0) == held_out] for run in reader.runs]
        step = (every or 1) if hz is None else _step(reader, hz)
        if hold_out and hz is not None:
            kept_hz = reader.hz * (1 - 1 / hold_out)
            step = max(1, round(kept_hz / hz))
        if held_out:
            step = max(1, round(step / (1 - 1 / hold_out) / hold_out))
        wanted = reader.names if cameras is None else tuple(cameras)
        if missing := [name for name in wanted if name not in reader.names]:
            raise DataError(f"expected the camera {missing[0]}, found {', '.join(reader.names)}: {reader.source}")
        views = tuple(reader.names.index(name) for name in wanted)
        runs = tuple(tuple(run) for run in chosen)
        if hz is not None and not held_out and reader.times_us is not None:
            runs = tuple(part for run in runs for part in _steady(run, reader.times_us, step, hz))
        return cls(reader, runs, frames, step, stride, views, None if held_out else hz)

    def _counts(self) -> list[int]:
        span = (self.frames - 1) * self.step
        return [max(0, -(-(len(run) - span) // self.stride)) for run in self.runs]

    def __len__(self) -> int:
        """Number of clips."""
        return sum(self._counts())

    def clip(self, index: int) -> Clip:
        """Read the clip with an index. Raises ``Skip`` if it has to be left out."""
        ends = list(accumulate(self._counts()))
        number = bisect_right(ends, index)
        run, first = self.runs[number], (index - (ends[number - 1] if number else 0)) * self.stride
        frames = [run[first + i * self.step] for i in range(self.frames)]
        before = [run[first - self.step] if first >= self.step else None, *frames[:-1]]
        read = self.reader.read(frames, self.views)
        hz = _rate(read.t_us, self.reader.hz / self.step)
        if self.hz is not None and not is_steady(read.t_us, self.hz):
            raise Skip(f"clips across gaps, such as that of frame {frames[0]} of {self.reader.source}")
        motions = [np.zeros(3, np.float32) if a is None else self.reader.motion(a, b) for a, b in zip(before, frames)]
        return Clip(
            color=read.color,
            bins=read.bins,
            boxes=read.boxes,
            map=read.map,
            images=read.images,
            cameras=read.cameras,
            action=torch.from_numpy(np.stack(motions)),
            global_from_ego=torch.from_numpy(read.global_from_ego),
            t_us=torch.from_numpy(read.t_us),
            original_sizes=torch.from_numpy(read.original_sizes),
            names=tuple(self.reader.names[view] for view in self.views),
            captions=read.captions,
            log=self.reader.log,
            frame=frames[0],
            hz=hz,
            recipe=self.reader.recipe,
        )


def _step(reader: FrameReader, hz: float) -> int:
    """Return how many frames of a log lie between frames at a rate."""
    if reader.hz <= 0:
        raise DataError(f"expected frames at an even rate for data.hz, found none: {reader.source}")
    step = frames_apart(reader.hz, hz)
    if step is None:
        raise DataError(
            f"expected data.hz that divides the rate of the frames, {reader.hz:.4g} Hz, found {hz}: {reader.source}"
        )
    return step


def frames_apart(log_hz: float, hz: float) -> int | None:
    """Return which frame of a log is the next one at a rate; ``None`` if the log's rate is not a multiple of it."""
    step = round(log_hz / hz)
    return step if step >= 1 and abs(log_hz / (hz * step) - 1) <= _RATE_TOLERANCE else None


def is_steady(times_us: npt.NDArray[np.int64], hz: float) -> bool:
    """Return whether each frame is within half an interval of its time at a rate."""
    off_s = (times_us - times_us[0]) / 1e6 - np.arange(len(times_us)) / hz
    return bool((np.abs(off_s) <= 0.5 / hz).all())


def _steady(run: tuple[int, ...], times_us: npt.NDArray[np.int64], step: int, hz: float) -> list[tuple[int, ...]]:
    """Split a run where frames are more than one and a half intervals apart."""
    longest_us = 1.5e6 / (hz * step)
    parts: list[tuple[int, ...]] = []
    first = 0
    for i in range(1, len(run)):
        if times_us[run[i]] - times_us[run[i - 1]] > longest_us:
            parts.append(run[first:i])
            first = i
    return [*parts, run[first:]]


def _rate(times_us: npt.NDArray[np.int64], usual: float) -> float:
    """Return the rate of a clip: of its median interval, or ``usual`` for a single frame."""
    if len(times_us) < 2:
        return usual
    interval = float(np.median(np.diff(times_us)))
    return 1e6 / interval if interval > 0 else usual
