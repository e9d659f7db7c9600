"""Tokens and locations, read from the tables of nuScenes and nuPlan: ``pskel.Log`` does not have them.

Tokens of images name the files of the layout pas-cache, tokens of scenes the captions that are published for nuScenes.
"""

from __future__ import annotations

import re
import sqlite3
from collections import defaultdict
from collections.abc import Sequence
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any

from ..errors import DataError, first_line
from .exports import read_json

__all__ = ["location_of", "scene_token", "tokens_of"]

_LOCATOR = re.compile(r"(?:(?P<format>[a-z0-9]+):)?(?P<path>[^@#]+)(?:@(?P<version>[^#]*))?(?:#(?P<scene>.*))?")


def tokens_of(text: str, log: str, times_us: Sequence[int], cameras: Sequence[str]) -> list[dict[str, str]]:
    """Return the tokens of the images of each key frame by camera.

    ``text`` is what ``pskel.Log`` opens, ``log`` the name of the log. An image belongs to the key frame that is nearest
    in time. Raises ``DataError`` for a log of another format than nuScenes, nuPlan and the synthetic town.
    """
    if text.startswith("town:"):
        return [{camera: f"{frame:06d}_{camera}" for camera in cameras} for frame in range(len(times_us))]
    kind, path, version = _located(text)
    if kind == "nuplan":
        return _nuplan(path, times_us, cameras)
    if kind == "nuscenes" and path.is_dir():
        return _nuscenes(path, version, log, len(times_us))
    raise DataError(f"expected a log of nuScenes or nuPlan for data.pas_cache, found {text}")


def scene_token(text: str, log: str) -> str | None:
    """Return the scene token of a log, by its text for ``pskel.Log`` and its name; ``None`` of other formats."""
    kind, path, version = _located(text)
    if kind != "nuscenes" or not path.is_dir():
        return None
    tables = _tables(path, version)
    return _scene_tokens(tables).get(log) if (tables / "scene.json").is_file() else None


def location_of(text: str) -> str:
    """Return the location of a log of nuPlan, such as ``las_vegas``; an empty text of other formats."""
    kind, path, _ = _located(text)
    rows = _query(path, "SELECT location FROM log") if kind == "nuplan" and path.is_file() else []
    return str(rows[0][0] or "") if rows else ""


def _located(text: str) -> tuple[str, Path, str | None]:
    """Return format, path and version of a log's text. Folders without a format may be of nuScenes."""
    match = _LOCATOR.fullmatch(text)
    path = Path(match["path"]) if match else Path(text)
    kind = (match["format"] if match else None) or ("nuplan" if path.suffix == ".db" else "nuscenes")
    return kind, path, match["version"] if match else None


def _nuscenes(root: Path, version: str | None, log: str, frames: int) -> list[dict[str, str]]:
    tables = _tables(root, version)
    scenes = _nuscenes_tokens(tables)
    if log not in scenes:
        raise DataError(f"expected scene {log}, found {len(scenes)} others: {tables / 'scene.json'}")
    if len(scenes[log]) != frames:
        raise DataError(f"expected {frames} key frames of {log}, found {len(scenes[log])}: {tables / 'sample.json'}")
    return scenes[log]


def _tables(root: Path, version: str | None) -> Path:
    """Return the folder of the tables."""
    folders = [root / version] if version else sorted(path.parent for path in root.glob("*/scene.json"))
    if len(folders) > 1:
        names = ", ".join(folder.name for folder in folders)
        raise DataError(f"expected a version after @, found several ({names}): {root}")
    return folders[0] if folders else root


def _table(tables: Path, name: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = read_json(tables / f"{name}.json", "a table of nuScenes")
    return rows


@lru_cache(maxsize=1)
def _scene_tokens(tables: Path) -> dict[str, str]:
    """Return the tokens of all scenes by name."""
    try:
        return {row["name"]: row["token"] for row in _table(tables, "scene")}
    except (KeyError, TypeError) as error:
        raise DataError(f"expected tables of nuScenes, found one without {error}: {tables}") from None


@lru_cache(maxsize=1)
def _nuscenes_tokens(tables: Path) -> dict[str, list[dict[str, str]]]:
    """Return the tokens of the key frames of all scenes."""

    try:
        channels = {row["token"]: row["channel"] for row in _table(tables, "sensor")}
        channels = {row["token"]: channels[row["sensor_token"]] for row in _table(tables, "calibrated_sensor")}
        images: dict[str, dict[str, str]] = defaultdict(dict)
        for row in _table(tables, "sample_data"):
            if row["is_key_frame"]:
                images[row["sample_token"]][channels[row["calibrated_sensor_token"]]] = row["token"]
        names = {row["token"]: row["name"] for row in _table(tables, "scene")}
        samples: dict[str, list[tuple[int, str]]] = defaultdict(list)
        for row in _table(tables, "sample"):
            samples[names[row["scene_token"]]].append((int(row["timestamp"]), row["token"]))
    except (KeyError, TypeError) as error:
        raise DataError(f"expected tables of nuScenes, found one without {error}: {tables}") from None
    return {name: [images[token] for _, token in sorted(rows)] for name, rows in samples.items()}


def _nuplan(path: Path, times_us: Sequence[int], cameras: Sequence[str]) -> list[dict[str, str]]:
    rows = _query(
        path,
        "SELECT image.token, image.timestamp, camera.channel FROM image "
        "JOIN camera ON camera.token = image.camera_token ORDER BY image.timestamp, image.token",
    )
    images: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for token, t_us, channel in rows:
        images[channel].append((int(t_us), token.hex() if isinstance(token, bytes) else str(token)))
    if missing := [camera for camera in cameras if not images[camera]]:
        raise DataError(f"expected images of {missing[0]}, found none: {path}")
    return [
        {camera: min(images[camera], key=lambda image: (abs(image[0] - t_us), image[0]))[1] for camera in cameras}
        for t_us in times_us
    ]


def _query(path: Path, query: str) -> list[tuple[Any, ...]]:
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
            return database.execute(query).fetchall()
    except sqlite3.Error as error:
        raise DataError(f"expected a log of nuPlan, found {first_line(error)}: {path}") from error
