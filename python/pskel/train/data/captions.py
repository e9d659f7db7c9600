"""Captions by log, frame and camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import DataError
from .exports import read_json

__all__ = ["CaptionOf", "Captions", "captions_of", "read_captions"]

CaptionOf = Callable[[str, int, str], str]
"""Caption of a log, a frame by its number in the log, and a camera by its channel."""
Captions = Mapping[str, str | Sequence[str | Sequence[str]]]
"""By name of a log: a text, or one per frame, or one per frame and camera in the order of the log."""


def captions_of(captions: CaptionOf | Captions | None, log: str, frame: int, cameras: Sequence[str]) -> tuple[str, ...]:
    """Return the captions of a frame, for all cameras of the log in its order; empty texts without.

    Raises ``ValueError`` for lists of another length than frames or cameras.
    """
    if callable(captions):
        return tuple(captions(log, frame, camera) for camera in cameras)
    found = (captions or {}).get(log, "")
    if not isinstance(found, str):
        if not -1 < frame < len(found):
            raise ValueError(f"expected captions of each frame of {log}, found {len(found)}, none of frame {frame}")
        found = found[frame]
    if isinstance(found, str):
        return (found,) * len(cameras)
    if len(found) != len(cameras):
        raise ValueError(f"expected captions of {len(cameras)} cameras in frame {frame} of {log}, found {len(found)}")
    return tuple(found)


def read_captions(path: str | None) -> Captions:
    """Read a JSON file of captions: ``Captions``, or ``{"LOG": {"time": "daytime", "weather": "clear"}}``.

    Such parts become ``daytime. clear``. Raises ``DataError``, which names the file, for other content.
    """
    if path is None:
        return {}
    value = read_json(Path(path), "captions")
    if not isinstance(value, dict):
        raise DataError(f"expected captions by name of a log, found {type(value).__name__}: {path}")
    return {log: _parsed(log, caption, path) for log, caption in value.items()}


def _parsed(log: str, value: Any, path: str) -> Any:
    if isinstance(value, str):
        return value
    if isinstance(value, dict) and set(value) <= {"time", "weather"}:
        return ". ".join(str(value[part]) for part in ("time", "weather") if value.get(part))
    if isinstance(value, list) and all(isinstance(each, str) or _is_texts(each) for each in value):
        return value
    raise DataError(f"expected a caption of {log}, or a list of them, found {str(value)[:40]}: {path}")


def _is_texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(text, str) for text in value)
