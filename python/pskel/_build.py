"""Building, with the options of ``pskel build`` as keyword arguments."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Protocol

from . import _pskel
from ._pskel import Log, Skeleton


class Progress(Protocol):
    """Receives the progress of a build: stages, and the steps of each."""

    def start(self, stage: str, steps: int, /) -> object:
        """Begin a stage."""

    def step(self) -> object:
        """Finish a step."""


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


def build(
    log: Log | Sequence[Log],
    out: str | PathLike[str],
    *,
    voxel: float | None = None,
    actor_voxel: float | None = None,
    every: int = 1,
    frames: tuple[int, int] | None = None,
    sweeps: bool = False,
    box_margin: float | None = None,
    coloring: str = "agreed",
    template: Mapping[str, str | PathLike[str]] | None = None,
    templates: bool = False,
    templates_from: str | PathLike[str] | None = None,
    resume: bool = False,
    checkpoint: int = 20,
    progress: bool | Progress = False,
) -> Skeleton:
    """Build a skeleton from logs and write it to a folder; an existing skeleton is replaced.

    Parameters
    ----------
    log : Log or sequence of Log
        Log, or several logs of one place that share a background.
    out : path
        Folder to write.
    voxel : float, optional
        Side of the voxels in which points are merged, meters; 0 retains all points. By default 0.01, and 0 with
        ``coloring="every-camera"``.
    actor_voxel : float, optional
        Side of the voxels for actors' points, meters; 0 retains all points. By default ``voxel``.
    every : int
        Use only every N-th frame.
    frames : (first, end), optional
        Range of frames, numbered from 0 in log order, ``end`` excluded. By default all.
    sweeps : bool
        Also use the sweeps between annotated frames, with interpolated boxes.
    box_margin : float, optional
        Grow boxes by this margin on every side before points are assigned to actors, meters. By default depends on
        ``coloring``.
    coloring : {"agreed", "every-camera"}
        How points are colored: one color on which images agree, or a copy per camera as existing scripts do.
    template : mapping, optional
        NPY or PLY files of templates by kind of actor (sedan, suv, pickup, pedestrian, bike, truck, bus, trailer,
        construction): points with x forward and z up.
    templates : bool
        Create templates from the log's own actors; ``template`` takes precedence.
    templates_from : path, optional
        Folder of ``pskel templates``, used for kinds that have no template yet.
    resume : bool
        Continue an interrupted build of the same logs, frames and options, if there is one.
    checkpoint : int
        Number of frames between checkpoints.
    progress : bool or Progress
        Show progress bars (needs tqdm), or report to an object. Ctrl-C stops the build in any case, and ``resume``
        continues it.

    Returns
    -------
    Skeleton
        The skeleton in ``out``.

    Raises
    ------
    ValueError
        For invalid options.
    BuildError
        If data cannot be read, or the folder cannot be written.
    RenderError
        In the fork of a process that has rendered images of the log.
    """
    keywords = locals()
    logs = [log] if isinstance(log, Log) else list(log)
    if not isinstance(progress, bool):
        return _pskel.build(logs, out, keywords, progress)
    bars = None
    if progress and (tqdm := progress_bar()):
        bars = _Bars(tqdm)
    try:
        return _pskel.build(logs, out, keywords, bars)
    finally:
        if bars is not None:
            bars.close()
