"""Recorded clips: safetensors files with an array per map, of which windows are read.

Arrays are ``color``, ``boxes``, ``map``, ``truth`` (U8 ``[F, V, H, W, 3]``), ``bins`` (U16 or I16 ``[F, V, H, W]``),
``action`` (F32 ``[F, 3]``) and ``cameras`` (F32 ``[F, V, 16]``). The metadata ``drive`` is JSON of log, source, rate,
cameras and recipe. Files of this package also have ``global_from_ego`` (F64 ``[F, 4, 4]``), ``t_us`` (I64 ``[F]``),
``original_sizes`` (I64 ``[V, 2]``) and the metadata ``clip``: JSON of variant, identity, captions (``[F][V]``, or null),
a digest of their file, and runs of frames without gaps.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..errors import ConfigError, DataError, first_line
from .numbers import CAMERA_NUMBERS, ego_motion, joined, moved_by
from .reader import FrameReader, Frames
from .recipe import complete, size_of

__all__ = ["RecordedReader", "Recorder", "recordings_in"]

_DTYPES = {"U8": np.uint8, "U16": np.uint16, "I16": np.int16, "F32": np.float32, "F64": np.float64, "I64": np.int64}
_RGB = ("color", "boxes", "map", "truth")
_MAX_HEADER = 100_000_000
Array = npt.NDArray[Any]


def recordings_in(folder: Path) -> list[Path]:
    """Return the recorded clips in a folder, by name."""
    return sorted(path for path in folder.glob("*.safetensors") if not path.name.startswith("."))


class RecordedReader(FrameReader):
    """A file of recorded frames, which is mapped into memory on first use in a process."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.source = os.fspath(path)
        header, self._data = _header(self.path)
        texts = header.pop("__metadata__", {})
        about, more = _json(texts, "drive", self.path), _json(texts, "clip", self.path) if "clip" in texts else {}
        try:
            self.log, self.hz = str(about["log"]), float(about["hz"])
            self.names = tuple(map(str, about["cameras"]))
            self.recipe = complete(about["recipe"])
        except (KeyError, TypeError, ValueError, ConfigError) as error:
            raise self._wrong(f"metadata without a valid {first_line(error)}") from None
        self.identity = str(more.get("identity", ""))
        self.variant = int(more.get("variant", 0))
        self._arrays = header
        self._maps: dict[str, Array] = {}
        try:
            frames = self._check()
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise self._wrong(f"an invalid header ({first_line(error)})") from None
        self.runs = [range(*run) for run in more.get("runs", [[0, frames]])]
        self.captions = more.get("captions")
        self._check_captions(frames)
        self.captions_content: str | None = more.get("captions_content")
        self._action = self._all("action")
        if "t_us" in header:
            self.times_us = self._all("t_us")
            self._poses: Array = self._all("global_from_ego")
            self._has_poses = True
            sizes = self._all("original_sizes")
        else:
            interval_us = 1e6 / self.hz if self.hz > 0 else 0.0
            self.times_us = np.round(np.arange(frames) * interval_us).astype(np.int64)
            self._poses, self._has_poses = _integrated(self._action), False
            sizes = np.tile(np.array(size_of(self.recipe["size"], "size"), np.int64), (len(self.names), 1))
        self._sizes: Array = sizes

    def _wrong(self, found: str) -> DataError:
        return DataError(f"expected a recorded clip, found {found}: {self.path}")

    def _check_captions(self, frames: int) -> None:
        def is_list(values: Any, length: int) -> bool:
            return isinstance(values, list) and len(values) == length

        rows = [] if self.captions is None else self.captions
        is_full = self.captions is None or is_list(rows, frames) and all(is_list(row, len(self.names)) for row in rows)
        if not is_full or not all(isinstance(text, str) for row in rows for text in row):
            raise self._wrong(f"captions other than texts of {frames} frames and {len(self.names)} cameras")

    def _check(self) -> int:
        """Check names, types and shapes of the arrays; returns the number of frames."""
        height, width = size_of(self.recipe["size"], "size")
        views, frames = len(self.names), (self._arrays.get("action", {}).get("shape") or [0])[0]
        if "truth" not in self._arrays:
            raise DataError(f"expected a clip with images (the array truth), found none: {self.path}")
        expected: dict[str, tuple[tuple[str, ...], list[int]]] = {
            **{name: (("U8",), [frames, views, height, width, 3]) for name in _RGB},
            "bins": (("U16", "I16"), [frames, views, height, width]),
            "action": (("F32",), [frames, 3]),
            "cameras": (("F32",), [frames, views, CAMERA_NUMBERS]),
        }
        if "t_us" in self._arrays:
            expected["t_us"] = (("I64",), [frames])
            expected["global_from_ego"] = (("F64",), [frames, 4, 4])
            expected["original_sizes"] = (("I64",), [views, 2])
        end = self.path.stat().st_size - self._data
        for name, (dtypes, shape) in expected.items():
            array = self._arrays.get(name)
            if array is None:
                raise self._wrong(f"no array {name}")
            first, last = array["data_offsets"]
            size = np.dtype(_DTYPES.get(array["dtype"], np.uint8)).itemsize * int(np.prod(shape))
            if array["dtype"] not in dtypes or array["shape"] != shape or last - first != size:
                raise self._wrong(f"{name} as {array['dtype']} {array['shape']} instead of {dtypes[0]} {shape}")
            if last > end:
                raise self._wrong("a file that was cut off")
        return int(frames)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_maps": {}}

    def _mapped(self, name: str) -> Array:
        if name not in self._maps:
            array = self._arrays[name]
            dtype, offset = _DTYPES[array["dtype"]], self._data + array["data_offsets"][0]
            # A window is read by its pages; the file is never read as a whole.
            mapped: Array = np.memmap(self.path, dtype, mode="r", offset=offset, shape=tuple(array["shape"]))
            self._maps[name] = mapped
        return self._maps[name]

    def _all(self, name: str) -> Array:
        return np.array(self._mapped(name))

    def _rgb(self, name: str, index: tuple[Array, ...]) -> Tensor:
        window = torch.from_numpy(self._mapped(name)[index])
        return window.permute(0, 1, 4, 2, 3).contiguous()

    def read(self, frames: Sequence[int], views: Sequence[int]) -> Frames:
        """Read a window."""
        index = np.ix_(np.array(frames), np.array(views))
        try:
            bins = self._mapped("bins")[index]
            color, boxes, map_, images = (self._rgb(name, index) for name in _RGB)
            cameras = self._mapped("cameras")[index]
        except OSError as error:
            raise DataError(f"recorded clips cannot be read: {error.strerror}: {self.path}") from error
        if int(bins.max(initial=0)) > self.recipe["bins"]["count"]:
            raise self._wrong(f"bin {int(bins.max())} of {self.recipe['bins']['count']}")
        assert self.times_us is not None
        return Frames(
            color=color,
            bins=torch.from_numpy(bins.astype(np.int16)),
            boxes=boxes,
            map=map_,
            images=images,
            cameras=torch.from_numpy(np.array(cameras)),
            global_from_ego=self._poses[list(frames)],
            t_us=self.times_us[list(frames)],
            original_sizes=self._sizes[list(views)],
            captions=self.captions_of(frames, views),
        )

    def motion(self, before: int, after: int) -> npt.NDArray[np.float32]:
        """Return the motion of the ego poses; of files without poses, the recorded motions in a row."""
        if after == before + 1:
            recorded: npt.NDArray[np.float32] = self._action[after]
            return recorded
        if self._has_poses:
            return ego_motion(self._poses[before], self._poses[after])
        total = np.zeros(3, np.float32)
        for frame in range(before + 1, after + 1):
            total = joined(total, self._action[frame])
        return total


class Recorder:
    """Writes a file of recorded clips frame by frame. It appears under its name when it is complete."""

    def __init__(self, path: Path, about: Mapping[str, Any], clip: Mapping[str, Any], frames: int) -> None:
        height, width = size_of(about["recipe"]["size"], "size")
        views = len(about["cameras"])
        shapes: list[tuple[str, str, list[int]]] = [
            # The largest types first, so that every array is aligned.
            ("global_from_ego", "F64", [frames, 4, 4]),
            ("t_us", "I64", [frames]),
            ("original_sizes", "I64", [views, 2]),
            ("action", "F32", [frames, 3]),
            ("cameras", "F32", [frames, views, CAMERA_NUMBERS]),
            ("bins", "U16", [frames, views, height, width]),
            *((name, "U8", [frames, views, height, width, 3]) for name in ("boxes", "color", "map", "truth")),
        ]
        self._path, self._partial = path, path.with_name(f".{path.name}.partial")
        self._places: dict[str, tuple[int, str, list[int]]] = {}
        texts = {"drive": json.dumps(about), "clip": json.dumps(clip)}
        header: dict[str, Any] = {"__metadata__": texts}
        offset = 0
        for name, dtype, shape in shapes:
            size = np.dtype(_DTYPES[dtype]).itemsize * int(np.prod(shape))
            header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [offset, offset + size]}
            self._places[name] = (offset, dtype, shape)
            offset += size
        content = json.dumps(header).encode()
        content += b" " * (-len(content) % 8)
        self._header = struct.pack("<Q", len(content)) + content
        self._data = len(self._header)
        self._size = self._data + offset
        self._file: BinaryIO

    def write(self, name: str, values: Array, frame: int | None = None) -> None:
        """Write a whole array, or its values of a frame."""
        offset, dtype, shape = self._places[name]
        expected = shape if frame is None else shape[1:]
        if list(values.shape) != expected:
            raise DataError(f"expected {name} of {expected}, found {list(values.shape)}: {self._path}")
        content = np.ascontiguousarray(values, _DTYPES[dtype]).tobytes()
        self._file.seek(self._data + offset + (0 if frame is None else frame * len(content)))
        self._file.write(content)

    def __enter__(self) -> Recorder:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(self._partial, "wb")
        try:
            self._file.write(self._header)
            self._file.truncate(self._size)
        except OSError:
            self.__exit__(OSError)
            raise
        return self

    def __exit__(self, kind: object, *_rest: object) -> None:
        try:
            if kind is None:
                self._file.flush()
                os.fsync(self._file.fileno())
                os.replace(self._partial, self._path)
        finally:
            try:
                self._file.close()  # writes what is buffered, which fails on a full disk
            finally:
                self._partial.unlink(missing_ok=True)


def _header(path: Path) -> tuple[dict[str, Any], int]:
    """Read the header of a safetensors file; returns it, and the place of the data."""
    try:
        with open(path, "rb") as file:
            start = file.read(8)
            length = struct.unpack("<Q", start)[0] if len(start) == 8 else 0
            header = json.loads(file.read(length)) if 2 <= length <= _MAX_HEADER else None
    except OSError as error:
        raise DataError(f"recorded clips cannot be read: {error.strerror}: {path}") from error
    except ValueError:
        header = None
    if not isinstance(header, dict):
        raise DataError(f"expected a safetensors file, found another one: {path}")
    return header, 8 + length


def _json(texts: Mapping[str, str], name: str, path: Path) -> dict[str, Any]:
    try:
        value = json.loads(texts[name])
    except (KeyError, ValueError):
        value = None
    if not isinstance(value, dict):
        raise DataError(f"expected a recorded clip with the metadata {name}, found none: {path}")
    return value


def _integrated(action: Array) -> npt.NDArray[np.float64]:
    """Return ego poses from motions, relative to the first frame."""
    poses = [np.eye(4)]
    for motion in action[1:]:
        poses.append(moved_by(poses[-1], motion))
    return np.stack(poses)
