"""Choice of clips, by numbers that are keyed by seed and number of the clip in the training."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from ..clip import Clip
from ..errors import DataError
from .reader import ClipSet, Skip

__all__ = ["Drawn", "Sampler"]

_ATTEMPTS = 50
"""Clips that are drawn in place of one that has to be left out."""
_EPOCHS, _DRAWS, _STATISTICS = 0, 1, 2
"""Purposes of random numbers."""


class Drawn(NamedTuple):
    """A clip, its name for messages, and why others were left out."""

    clip: Clip
    name: str
    skipped: tuple[str, ...]


class Sampler:
    """Draws clips of several logs.

    Without ``shares``, each clip comes once per epoch, in another order in each. With them, a log is drawn by its
    share, then one of its clips, with replacement.
    """

    def __init__(self, clip_sets: Sequence[ClipSet], shares: Sequence[float] | None, seed: int) -> None:
        self.clip_sets = clip_sets
        self.shares = shares
        self.seed = seed
        self._ends = list(accumulate(len(clip_set) for clip_set in clip_sets))
        if not self._ends or self._ends[-1] == 0:
            raise DataError("expected clips to train on, found none")
        if shares is not None:
            usable = [share if len(clip_set) else 0.0 for share, clip_set in zip(shares, clip_sets, strict=True)]
            if sum(usable) <= 0:
                raise DataError("expected a log with a weight above 0 that has clips, found none")
            self._cumulative = np.cumsum(np.array(usable, np.float64) / sum(usable))

    def __len__(self) -> int:
        """Number of clips."""
        return self._ends[-1]

    def _random(self, *key: int) -> np.random.Generator:
        return np.random.default_rng((self.seed, *key))

    def choose(self, number: int, attempt: int = 0) -> tuple[int, int]:
        """Return clip set and clip of the clip with a number in the training."""
        if self.shares is None and attempt == 0:
            epoch, place = divmod(number, len(self))
            return self._place(int(_permutation(self.seed, epoch, len(self))[place]))
        return self._drawn(self._random(_DRAWS, number, attempt))

    def _place(self, index: int) -> tuple[int, int]:
        clip_set = bisect_right(self._ends, index)
        return clip_set, index - (self._ends[clip_set - 1] if clip_set else 0)

    def _drawn(self, random: np.random.Generator) -> tuple[int, int]:
        if self.shares is None:
            return self._place(int(random.integers(len(self))))
        clip_set = min(int(np.searchsorted(self._cumulative, random.random(), side="right")), len(self.clip_sets) - 1)
        while not len(self.clip_sets[clip_set]):  # after rounding at the end
            clip_set -= 1
        return clip_set, int(random.integers(len(self.clip_sets[clip_set])))

    def draw(self, number: int) -> Drawn:
        """Read the clip with a number in the training, or another one in its place if it has to be left out.

        Raises ``DataError`` if no clip can be used.
        """
        return self._read(self.choose(number, attempt) for attempt in range(_ATTEMPTS))

    def statistic(self, number: int) -> Drawn:
        """Read a clip for statistics by its number, drawn with replacement."""
        return self._read(self._drawn(self._random(_STATISTICS, number, attempt)) for attempt in range(_ATTEMPTS))

    def _read(self, choices: Iterator[tuple[int, int]]) -> Drawn:
        skipped: list[str] = []
        for clip_set, index in choices:
            try:
                clip = self.clip_sets[clip_set].clip(index)
            except Skip as reason:
                skipped.append(str(reason))
                continue
            return Drawn(clip, f"{self.clip_sets[clip_set].reader.label}:{clip.frame}", tuple(skipped))
        raise DataError(f"expected clips that can be used, found {_ATTEMPTS} others in a row: {skipped[-1]}")


@lru_cache(maxsize=2)
def _permutation(seed: int, epoch: int, count: int) -> np.ndarray[Any, np.dtype[np.int64]]:
    return np.random.default_rng((seed, _EPOCHS, epoch)).permutation(count)
