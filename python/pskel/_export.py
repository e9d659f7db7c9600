"""Export of condition maps, with the options of ``pskel export`` as keyword arguments."""

from __future__ import annotations

import json
from collections.abc import Sequence
from os import PathLike, fspath
from typing import Any, TypedDict

from ._build import progress_bar
from ._pskel import Export


class Failure(TypedDict):
    """A log or shard that failed."""

    name: str
    error: str


class ExportReport(TypedDict):
    """Counts of shards, and everything that was skipped or failed."""

    written: int
    present: int
    busy: int
    samples: int
    built: int
    notes: dict[str, int]
    failures: list[Failure]
    complete: bool


class _Bar:
    """Shows the key frames done in a tqdm bar."""

    def __init__(self, tqdm: Any, frames: int) -> None:
        self._bar = tqdm(total=frames, unit="frame")

    def frame(self, shard: str) -> None:
        self._bar.set_postfix_str(shard)
        self._bar.update()

    def skip(self, frames: int) -> None:
        self._bar.update(frames)

    def close(self) -> None:
        self._bar.close()


def arguments(options: dict[str, Any]) -> list[str]:
    """Convert keyword arguments to command-line arguments.

    ``True`` is a flag; ``None`` and ``False`` are left out; a pair of numbers is a size; other sequences are lists.
    """
    args = []
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            args.append(option)
        elif isinstance(value, (tuple, list)):
            is_size = len(value) == 2 and all(isinstance(side, int) for side in value)
            args.append(f"{option}={('x' if is_size else ',').join(map(str, value))}")
        else:
            args.append(f"{option}={fspath(value) if isinstance(value, PathLike) else value}")
    return args


def export(
    logs: str | Sequence[str],
    out: str | PathLike[str],
    *,
    layout: str,
    skeletons: str | PathLike[str],
    progress: bool = False,
    **options: Any,
) -> ExportReport:
    """Export the condition maps of logs into a folder; existing shards are skipped.

    Options as of ``pskel export``: ``out_size=(256, 448)``, ``maps=["color", "depth"]``, ``images=True``,
    ``shard_frames=64``, ``only="0/4"`` and so on. The report lists failed logs and shards. ``progress=True``
    shows a bar; it needs tqdm. Ctrl-C stops; the same call continues. Raises ``ValueError`` for invalid
    options, and ``Error`` if the folder cannot be written or holds an export with other options.
    """
    logs = [logs] if isinstance(logs, str) else list(logs)
    given = arguments({"out": out, "layout": layout, "skeletons": skeletons, **options})
    job = Export([*logs, *given])
    bar = None
    if progress and (tqdm := progress_bar()):
        bar = _Bar(tqdm, sum(end - first for _, _, first, end in job.shards))
    try:
        report: ExportReport = json.loads(job.run(progress=bar))
        return report
    finally:
        if bar is not None:
            bar.close()
