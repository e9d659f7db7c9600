"""Tokens of scenes and locations, by which captions are published, read from the tables of nuScenes and nuPlan.

``pskel.Log`` has both, but opening all logs of a data set takes long.
"""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any

from ..errors import DataError, first_line
from .exports import read_json

__all__ = ["location_of", "scene_token"]

_LOCATOR = re.compile(r"(?:(?P<format>[a-z0-9]+):)?(?P<path>[^@#]+)(?:@(?P<version>[^#]*))?(?:#(?P<scene>.*))?")


def scene_token(text: str, log: str) -> str | None:
    """Return the scene token of a log, by its text for ``pskel.Log`` and its name; ``None`` of other formats."""
    kind, path, version = _located(text)
    if kind != "nuscenes" or not path.is_dir():
        return None
    tables = _tables(path, version)
    return _scene_tokens(tables).get(log) if (tables / "scene.json").is_file() else None


def location_of(text: str) -> str:
    """Return a nuPlan log's location, such as ``las_vegas``; an empty text for other formats."""
    kind, path, _ = _located(text)
    rows = _query(path, "SELECT location FROM log") if kind == "nuplan" and path.is_file() else []
    return str(rows[0][0] or "") if rows else ""


def _located(text: str) -> tuple[str, Path, str | None]:
    """Return format, path and version of a log's text. Folders without a format may be of nuScenes."""
    match = _LOCATOR.fullmatch(text)
    path = Path(match["path"]) if match else Path(text)
    kind = (match["format"] if match else None) or ("nuplan" if path.suffix == ".db" else "nuscenes")
    return kind, path, match["version"] if match else None


def _tables(root: Path, version: str | None) -> Path:
    """Return the folder of the tables."""
    folders = [root / version] if version else sorted(path.parent for path in root.glob("*/scene.json"))
    if len(folders) > 1:
        names = ", ".join(folder.name for folder in folders)
        raise DataError(f"expected a version after @, found several ({names}): {root}")
    return folders[0] if folders else root


@lru_cache(maxsize=1)
def _scene_tokens(tables: Path) -> dict[str, str]:
    """Return the tokens of all scenes by name."""
    try:
        return {row["name"]: row["token"] for row in read_json(tables / "scene.json", "a table of nuScenes")}
    except (KeyError, TypeError) as error:
        raise DataError(f"expected tables of nuScenes, found one without {error}: {tables}") from None


def _query(path: Path, query: str) -> list[tuple[Any, ...]]:
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
            return database.execute(query).fetchall()
    except sqlite3.Error as error:
        raise DataError(f"expected a log of nuPlan, found {first_line(error)}: {path}") from error
