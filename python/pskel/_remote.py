"""Logs and exports in object stores, through fsspec."""

from __future__ import annotations

import posixpath
import warnings
from pathlib import Path
from typing import Any

from ._pskel import Log

__all__ = ["fetch", "is_remote", "store", "upload"]


def is_remote(text: str) -> bool:
    """Whether a path or the name of a log is a URL."""
    return "://" in text


def store(url: str) -> tuple[Any, str]:
    """Open the file system of a URL; returns it and the path in it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise ImportError("URLs need fsspec: pip install 'pskel[ray]'") from error
    system, path = url_to_fs(url)
    return system, path.rstrip("/")


def split(log: str) -> tuple[str, str, str]:
    """Split the name of a log into format, path, and the rest (``@VERSION#SCENE``)."""
    kind, rest = log.split(":", 1)
    path, mark, scene = rest.partition("#")
    path, at, version = path.partition("@")
    return kind, path, at + version + mark + scene


def fetch(log: str, folder: Path, *, sensors: bool) -> str:
    """Copy the files of a remote log below a folder, and return the name of the copy.

    Without ``sensors``, copies only tables, which suffice to list its frames. Existing files are not copied
    again.
    """
    kind, url, rest = split(log)
    system, root = store(url)
    if kind == "nuscenes":
        _fetch_nuscenes(system, root, rest, folder, sensors)
        return f"{kind}:{folder / posixpath.basename(root)}{rest}"
    if kind == "av2":
        below = [path for path in system.find(root) if sensors or "/sensors/" not in path[len(root) :]]
        _copy(system, below, posixpath.dirname(root), folder)
        return f"{kind}:{folder / posixpath.basename(root)}{rest}"
    if kind == "nuplan" and root.endswith(".db"):
        # nuplan-v1.1/splits/SPLIT/LOG.db, nuplan-v1.1/sensor_blobs/LOG and, beside nuplan-v1.1, maps
        version = posixpath.dirname(posixpath.dirname(posixpath.dirname(root)))
        base = posixpath.dirname(version)
        name = posixpath.basename(root)[: -len(".db")]
        below = [root, *_find(system, f"{base}/maps")]
        if sensors:
            below += _find(system, f"{version}/sensor_blobs/{name}")
        _copy(system, below, base, folder)
        return f"{kind}:{folder / posixpath.relpath(root, base)}{rest}"
    raise ValueError(f"expected nuscenes:URL, av2:URL or nuplan:URL of a .db file for a remote log, found {log}")


def _fetch_nuscenes(system: Any, root: str, rest: str, folder: Path, sensors: bool) -> None:
    base = posixpath.dirname(root)
    version = rest[1:].split("#")[0] if rest.startswith("@") else ""
    for path in system.ls(root, detail=False):
        name = posixpath.basename(path.rstrip("/"))
        if name == version or (not version and name.startswith("v1.0-")) or name == "maps":
            _copy(system, _find(system, path), base, folder)
    if sensors:
        local = folder / posixpath.basename(root)
        with warnings.catch_warnings():  # no sweep or image is here yet
            warnings.simplefilter("ignore")
            opened = Log(f"nuscenes:{local}{rest}")
        below = [f"{root}/{Path(path).relative_to(local).as_posix()}" for path in opened.files]
        _copy(system, below, base, folder)


def _find(system: Any, path: str) -> list[str]:
    return list(system.find(path)) if system.exists(path) else []


def _copy(system: Any, paths: list[str], base: str, folder: Path) -> None:
    for path in paths:
        target = folder / posixpath.relpath(path, base)
        if target.exists():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(target.name + ".part")
        try:
            system.get_file(path, str(partial))
        except FileNotFoundError:  # readers count what the log names and does not have
            continue
        partial.replace(target)


def upload(folder: Path, url: str, shards: list[str]) -> None:
    """Copy complete shards of a local export to a URL: the files first, then the records."""
    system, root = store(url)
    records = {folder / "shards" / f"{shard}.json" for shard in shards}
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and ".unfinished" not in path.parts]
    for path in [*(path for path in files if path not in records), *(path for path in files if path in records)]:
        if path.parent.name == "shards" and path not in records:
            continue
        target = f"{root}/{path.relative_to(folder).as_posix()}"
        system.makedirs(posixpath.dirname(target), exist_ok=True)
        system.put_file(str(path), target)
