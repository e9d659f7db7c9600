"""Building with a progress bar."""

import warnings
from os import PathLike
from typing import Any

from . import _pskel
from ._pskel import Log, Skeleton


def progress_bar() -> Any:
    """Return the bar of tqdm, or warn that it is missing and return ``None``."""
    try:
        from tqdm.auto import tqdm
    except ImportError:
        warnings.warn("progress=True needs tqdm: pip install tqdm", stacklevel=3)
        return None
    return tqdm


class _Bars:
    """Shows one tqdm bar per stage."""

    def __init__(self, tqdm: Any) -> None:
        self._tqdm = tqdm
        self._bar: Any = None

    def start(self, stage: str, steps: int) -> None:
        self.close()
        self._bar = self._tqdm(total=steps, desc=stage)

    def step(self) -> None:
        self._bar.update()

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


def build(log: Log, out: str | PathLike[str], *, resume: bool = False, progress: bool = False) -> Skeleton:
    """Build a skeleton from all frames of a log and write it to a folder; an existing skeleton is replaced.

    ``progress=True`` shows progress bars; it needs tqdm. Ctrl-C stops the build. ``resume=True`` continues an
    unfinished build of the same log from its last checkpoint, which is written every 20 frames; without one, it begins
    again. Raises ``BuildError``, and ``RenderError`` in the fork of a process that has rendered images of the log.
    """
    bars = None
    if progress and (tqdm := progress_bar()):
        bars = _Bars(tqdm)
    try:
        return _pskel.build(log, out, resume=resume, progress=bars)
    finally:
        if bars is not None:
            bars.close()
