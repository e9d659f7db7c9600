"""Folders of ``pskel export``: options and records of shards."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import DataError

__all__ = ["Record", "export_options", "read_json", "records_in"]


class Record(NamedTuple):
    """A complete shard."""

    name: str
    log: str
    first: int
    """First key frame."""
    end: int
    samples: int
    notes: Mapping[str, int]
    files: tuple[str, ...]
    """Paths in the export."""


def read_json(path: Path, what: str) -> Any:
    """Read a JSON file. Raises ``DataError``, which names it."""
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise DataError(f"{what} cannot be read: {error.strerror}: {path}") from error
    except ValueError:
        raise DataError(f"expected {what} as JSON, found another file: {path}") from None


def export_options(folder: Path) -> dict[str, Any]:
    """Return the options of an export. Raises ``DataError`` for another file ``export.json``."""
    path = folder / "export.json"
    document = read_json(path, "the options of an export")
    options = document.get("options") if isinstance(document, dict) else None
    if not isinstance(options, dict) or not isinstance(options.get("export_layout"), str):
        raise DataError(f"expected the options of an export, found another file: {path}")
    return options


def records_in(folder: Path) -> list[Record]:
    """Return the records of all complete shards, by log and first frame. Raises ``DataError`` for another file."""
    found = []
    for path in sorted((folder / "shards").glob("*.json")):
        value = read_json(path, "the record of a shard")
        try:
            first, end = value["frames"]
            files = tuple(file["path"] for file in value["files"])
            found.append(Record(value["name"], value["log"], first, end, value["samples"], value["notes"], files))
        except (KeyError, TypeError, ValueError):
            raise DataError(f"expected the record of a shard, found another file: {path}") from None
    if not found:
        raise DataError(f"expected complete shards, found none: {folder / 'shards'}")
    return sorted(found, key=lambda record: (record.log, record.first))
