"""Captions by log, frame and camera."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import DataError
from .exports import read_json
from .tokens import location_of, scene_token

__all__ = ["Caption", "CaptionOf", "Captions", "captions_of", "captions_of_log", "read_captions"]

Parts = Mapping[str, str]
"""Parts of a caption, by ``PARTS``; parts may be missing."""
ImageCaptions = Mapping[str, Mapping[int, Parts]]
"""Captions of a log's images, by channel and time in microseconds."""
Caption = str | Sequence[str | Sequence[str]] | ImageCaptions
"""Of a log: a text, one per frame, one per frame and camera in the order of the log, or captions of images."""
CaptionOf = Callable[[str, int, str], str]
"""Caption of a log, a frame by its number in the log, and a camera by its channel."""
Captions = Mapping[str, Caption | Parts]
"""By name of a log, or by scene token for captions of images."""

PARTS = ("time", "weather", "environment", "objects", "image_description")
_COMMON = PARTS[:2]
"""Parts that all cameras of a frame have in common."""
_EXPECTED = (
    'expected captions {"LOG": "text"}, {"LOG": ["text of a frame", ["text of a camera", ..], ..]}, '
    '{"LOG": {"time": .., "weather": ..}} or {"SCENE_TOKEN|CHANNEL|TIME_US": {"time": .., ..}}'
)


def read_captions(path: str | os.PathLike[str] | None) -> Captions:
    """Read a JSON file of captions.

    Values are texts, lists of texts per frame, lists of lists of texts per frame and camera, or ``{"time", "weather"}``
    as in ``nuplan_text.json`` of *Point as Skeleton*. Files that OpenDWM publishes for nuScenes have keys
    ``SCENE_TOKEN|CHANNEL|TIME_US`` and values of ``PARTS``. Raises ``DataError``, which names the file and the key, for
    other content.
    """
    if path is None:
        return {}
    document = read_json(Path(path), "captions")
    if not isinstance(document, dict):
        raise DataError(f"{_EXPECTED}, found {str(document)[:40]}: {path}")
    found: dict[str, Any] = {}
    of_images: dict[str, dict[str, dict[int, Parts]]] = {}
    for key, value in document.items():
        image = _image_key(key)
        known = PARTS if image is not None else _COMMON
        if isinstance(value, dict) and set(value) <= set(known) and all(map(_is_text_or_none, value.values())):
            parts = {name: text for name, text in value.items() if text}
            if image is None:
                found[key] = parts
            else:
                scene, channel, t_us = image
                of_images.setdefault(scene, {}).setdefault(channel, {})[t_us] = parts
        elif image is None and (isinstance(value, str) or _is_list_of_texts(value)):
            found[key] = value
        else:
            raise DataError(f"{_EXPECTED}, found {str(value)[:60]} for {key!r}: {path}")
    return {**of_images, **found}


def _image_key(key: str) -> tuple[str, str, int] | None:
    """Return scene token, channel and time of a key; ``None`` if it is the name of a log."""
    parts = key.rsplit("|", 2)
    return (parts[0], parts[1], int(parts[2])) if len(parts) == 3 and parts[2].isdecimal() else None


def _is_text_or_none(value: Any) -> bool:
    return value is None or isinstance(value, str)


def _is_list_of_texts(value: Any) -> bool:
    def is_list(each: Any) -> bool:
        return isinstance(each, list) and all(isinstance(text, str) for text in each)

    return isinstance(value, list) and all(isinstance(each, str) or is_list(each) for each in value)


def captions_of_log(captions: Captions, text: str, log: str) -> dict[str, Caption]:
    """Return the captions of a log by its name; empty without. ``text`` is what ``pskel.Log`` opens.

    Time and weather become the captions of the published networks for nuPlan, such as ``daytime. clear. This is a
    nuplan video clip from las_vegas``. Captions of images are found by the scene token in the tables of nuScenes.
    """
    found: Any = captions.get(log)
    if found is None and any(_are_of_images(value) for value in captions.values()):
        found = captions.get(scene_token(text, log) or "")
    if found is None:
        return {}
    if isinstance(found, Mapping) and not _are_of_images(found):
        location = location_of(text)
        clip = f"This is a nuplan video clip from {location}" if location else "This is a nuplan video clip"
        found = ". ".join(filter(None, [*(found.get(part) for part in _COMMON), clip]))
    return {log: found}


def _are_of_images(value: Any) -> bool:
    return isinstance(value, Mapping) and any(isinstance(each, Mapping) for each in value.values())


def captions_of(
    captions: CaptionOf | Mapping[str, Caption], log: str, frame: int, t_us: int, cameras: Sequence[str]
) -> tuple[str, ...]:
    """Return the captions of a frame, for all cameras of the log in its order; empty texts without.

    Of captions of images, each camera has the one nearest to ``t_us``; the earlier of two. Raises ``ValueError`` for
    lists of another length than frames or cameras, and for images of other cameras.
    """
    if callable(captions):
        return tuple(captions(log, frame, camera) for camera in cameras)
    found = captions.get(log, "")
    if isinstance(found, Mapping):
        return _nearest(found, log, t_us, cameras)
    if not isinstance(found, str):
        if not -1 < frame < len(found):
            raise ValueError(f"expected captions of each frame of {log}, found {len(found)}, none of frame {frame}")
        found = found[frame]
    if isinstance(found, str):
        return (found,) * len(cameras)
    if len(found) != len(cameras):
        raise ValueError(f"expected captions of {len(cameras)} cameras in frame {frame} of {log}, found {len(found)}")
    return tuple(found)


def _nearest(captions: ImageCaptions, log: str, t_us: int, cameras: Sequence[str]) -> tuple[str, ...]:
    """Return the captions nearest in time. Most cameras decide on time and weather, the first one in a tie."""
    if not any(camera in captions for camera in cameras):
        raise ValueError(f"expected captions of {cameras[0]} in {log}, found those of {', '.join(captions)}")
    found = {
        camera: captions[camera][min(captions[camera], key=lambda other: (abs(other - t_us), other))]
        for camera in cameras
        if camera in captions
    }
    counts = {part: Counter(parts[part] for parts in found.values() if part in parts) for part in _COMMON}
    common = {part: count.most_common(1)[0][0] for part, count in counts.items() if count}

    def text(parts: Parts) -> str:
        own = {**parts, **common}
        return ". ".join(own[part] for part in PARTS if part in own)

    return tuple(text(found[camera]) if camera in found else "" for camera in cameras)
