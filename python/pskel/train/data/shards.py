"""Shards of ``pskel export --layout webdataset --images``.

A shard is a tar file whose members are read by their places. A process indexes a shard when it reads from it for the
first time.
"""

from __future__ import annotations

import io
import json
import os
import tarfile
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from ..errors import DataError
from .exports import Record, export_options, records_in
from .images import rgb_of, rgb_tensor
from .numbers import camera_numbers, ego_motion
from .reader import FrameReader, Frames, Skip
from .recipe import BINS, depth_bins, of_export

__all__ = ["ShardReader", "shard_readers"]

_OPEN_SHARDS = 8
_SAMPLES_OF_RATE = 17
Array = npt.NDArray[Any]


class _Sample(NamedTuple):
    """Places of a sample's members in the tar file: first byte and size, by name without the key, in lower case."""

    key: str
    members: dict[str, tuple[int, int]]


class _Shard:
    """An indexed tar file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = open(path, "rb")
            with tarfile.open(fileobj=self._file, mode="r:") as tar:
                members = [(member.name, member.offset_data, member.size) for member in tar if member.isfile()]
        except OSError as error:
            raise DataError(f"the shard cannot be read: {error.strerror or error}: {path}") from error
        except tarfile.TarError as error:
            raise DataError(f"expected a tar file, found {error}: {path}") from None
        # Keys may contain dots, as those of nuPlan; the metadata are the first file of a sample.
        self.samples: list[_Sample] = []
        self.metas: dict[int, dict[str, Any]] = {}
        key = ""
        for name, place, size in members:
            if name.endswith(".json"):
                key = name[: -len(".json")]
                self.samples.append(_Sample(key, {}))
            if not self.samples or not name.startswith(f"{key}."):
                raise DataError(f"expected samples that begin with their .json, found {name}: {path}")
            self.samples[-1].members[name[len(key) + 1 :].lower()] = (place, size)

    def read(self, sample: int, name: str) -> bytes | None:
        """Return the content of a sample's member; ``None`` without it."""
        place = self.samples[sample].members.get(name)
        if place is None:
            return None
        content = os.pread(self._file.fileno(), place[1], place[0])
        if len(content) != place[1]:
            raise DataError(
                f"expected {place[1]} bytes of {self.samples[sample].key}.{name}, found {len(content)}: {self.path}"
            )
        return content

    def meta(self, sample: int) -> dict[str, Any]:
        """Return the metadata of a sample."""
        if sample not in self.metas:
            if sample >= len(self.samples):
                raise DataError(f"expected sample {sample}, found {len(self.samples)} samples: {self.path}")
            try:
                value = json.loads(self.read(sample, "json") or b"null")
            except ValueError:
                value = None
            if not isinstance(value, dict) or not isinstance(value.get("cameras"), list):
                raise DataError(
                    f"expected metadata of a sample, found others in {self.samples[sample].key}.json: {self.path}"
                )
            self.metas[sample] = value
        return self.metas[sample]

    def close(self) -> None:
        self._file.close()


_shards: OrderedDict[tuple[Path, int, int], _Shard] = OrderedDict()
"""By path, time and size of the file."""


def _shard(path: Path) -> _Shard:
    """Open and index a shard in this process; the least recently used ones are closed.

    File places are read with ``pread``, so that a fork may share the file with its parent.
    """
    try:
        about = path.stat()
    except OSError as error:
        raise DataError(f"the shard cannot be read: {error.strerror}: {path}") from error
    key = path, about.st_mtime_ns, about.st_size
    shard = _shards.pop(key, None)
    if shard is None:
        while len(_shards) >= _OPEN_SHARDS:
            _shards.popitem(last=False)[1].close()
        shard = _Shard(path)
    _shards[key] = shard
    return shard


class ShardReader(FrameReader):
    """The shards of a log."""

    def __init__(self, folder: Path, records: Sequence[Record], options: Mapping[str, Any]) -> None:
        self.log = records[0].log
        self.source = f"{folder} ({self.log})"
        self._paths = [folder / f"{record.name}.tar" for record in records]
        ends = np.cumsum([record.samples for record in records])
        self._ends: list[int] = [int(end) for end in ends]
        self.runs = list(_runs(records))
        self._format = str(options["format"])
        self._times = options["times"]
        shard = _shard(self._paths[0])
        meta = shard.meta(0)
        try:
            self.names = tuple(camera["name"] for camera in meta["cameras"])
            sizes = {(int(camera["height"]), int(camera["width"])) for camera in meta["cameras"]}
            self.hz = float(meta.get("fps") or 0.0) or self._usual_rate(shard)
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"expected metadata of a sample, found {error!r}: {shard.path}") from None
        if "global_from_ego" not in meta or any("original_size" not in camera for camera in meta["cameras"]):
            text = "global_from_ego and original_size, found an export of an earlier version: export again"
            raise DataError(f"expected samples with {text}: {shard.path}")
        if len(sizes) != 1:
            raise DataError(f"expected cameras with maps of one size, found {sorted(sizes)}: {shard.path}")
        self.size = sizes.pop()
        self.recipe = of_export(options, self.size)
        self._bins = self.recipe["bins"]

    @staticmethod
    def _usual_rate(shard: _Shard) -> float:
        """Return the rate of the first samples' median interval, for samples that are not evenly spaced."""
        count = min(len(shard.samples), _SAMPLES_OF_RATE)
        times = np.array([shard.meta(sample)["t_us"] for sample in range(count)], np.int64)
        interval = float(np.median(np.diff(times))) if count > 1 else 0.0
        return 1e6 / interval if interval > 0 else 0.0

    def _place(self, frame: int) -> tuple[_Shard, int]:
        number = int(np.searchsorted(self._ends, frame, side="right"))
        first = self._ends[number - 1] if number else 0
        return _shard(self._paths[number]), frame - first

    def _required(self, shard: _Shard, sample: int, name: str) -> bytes:
        content = shard.read(sample, name)
        if content is None:
            raise DataError(f"expected {shard.samples[sample].key}.{name} in the shard, found none: {shard.path}")
        return content

    def _view(self, shard: _Shard, sample: int, camera: str) -> dict[str, Array]:
        """Return the maps and the image of a camera."""
        low = camera.lower()
        source = f"{shard.samples[sample].key}.{{}}.{low} in {shard.path}"
        jpeg = shard.read(sample, f"image.{low}.jpg")
        if jpeg is None:
            raise Skip(f"clips without an image of {camera}, such as frame {shard.samples[sample].key} of {shard.path}")
        found: dict[str, Array] = {"images": rgb_of(jpeg, source.format("image"), self.size)}
        if self._format == "safetensors":
            return found
        for kind in ("color", "boxes", "map"):
            name = f"{kind}.{low}.png"
            content = shard.read(sample, name) if kind == "map" else self._required(shard, sample, name)
            empty = np.zeros((*self.size, 3), np.uint8)
            found[kind] = empty if content is None else self._of_size(rgb_of(content, source.format(kind)), name, shard)
        values = np.load(io.BytesIO(self._required(shard, sample, f"depth.{low}.npy")), allow_pickle=False)
        found["bins"] = self._of_size(values.astype(np.int32) // (65535 // int(self._bins["count"])), "depth", shard)
        return found

    def _of_size(self, array: Array, name: str, shard: _Shard) -> Array:
        if array.shape[:2] != self.size:
            raise DataError(f"expected {name} of {self.size}, found {array.shape[:2]}: {shard.path}")
        return array

    def _frame(self, shard: _Shard, sample: int, views: Sequence[int]) -> list[dict[str, Array]]:
        found = [self._view(shard, sample, self.names[view]) for view in views]
        if self._format != "safetensors":
            return found
        from safetensors.numpy import load

        arrays = load(self._required(shard, sample, "conditions.safetensors"))
        if missing := [name for name in ("color", "boxes", "depth") if name not in arrays]:
            raise DataError(f"expected the map {missing[0]}, found {', '.join(arrays)}: {shard.path}")
        bins = depth_bins(arrays["depth"], self._bins)
        map_ = arrays.get("map", np.zeros_like(arrays["color"]))
        for maps, view in zip(found, views):
            maps.update(color=arrays["color"][view], boxes=arrays["boxes"][view], map=map_[view], bins=bins[view])
        return found

    def read(self, frames: Sequence[int], views: Sequence[int]) -> Frames:
        """Decode frames."""
        places = [self._place(frame) for frame in frames]
        found = [self._frame(shard, sample, views) for shard, sample in places]
        metas = [self._meta(shard, sample) for shard, sample in places]
        cameras = [[meta["cameras"][view] for view in views] for meta in metas]

        def rgb(name: str) -> torch.Tensor:
            return rgb_tensor([[view[name] for view in frame] for frame in found])

        numbers = [
            camera_numbers(
                np.array([camera["ego_from_camera"] for camera in row], np.float64),
                np.array([camera["intrinsics"] for camera in row], np.float64),
                np.array([[camera["height"], camera["width"]] for camera in row], np.float64),
            )
            for row in cameras
        ]
        return Frames(
            color=rgb("color"),
            bins=torch.from_numpy(np.stack([[view["bins"] for view in frame] for frame in found]).astype(np.int16)),
            boxes=rgb("boxes"),
            map=rgb("map"),
            images=rgb("images"),
            cameras=torch.from_numpy(np.stack(numbers)),
            global_from_ego=np.stack([self._pose(frame) for frame in frames]),
            t_us=np.array([meta["t_us"] for meta in metas], np.int64),
            original_sizes=np.array([camera["original_size"] for camera in cameras[0]], np.int64),
            captions=tuple(tuple(camera.get("caption") or "" for camera in row) for row in cameras),
        )

    def _meta(self, shard: _Shard, sample: int) -> dict[str, Any]:
        meta = shard.meta(sample)
        names = tuple(camera.get("name") for camera in meta["cameras"])
        if names != self.names:
            raise Skip(f"samples without all cameras, such as {shard.samples[sample].key} of {shard.path}")
        if any(camera.get("ego_from_camera") is None for camera in meta["cameras"]):
            raise DataError(f"expected ego_from_camera of all cameras, found null: {shard.path}")
        if isinstance(self._times, Mapping) and self.hz > 0:
            # Samples at a rate have the nearest image, which may be another sample's.
            off_us = max(abs((camera.get("t_us") or meta["t_us"]) - meta["t_us"]) for camera in meta["cameras"])
            if off_us > 0.5e6 / self.hz:
                key = shard.samples[sample].key
                raise Skip(
                    f"clips with images of other times, such as {key} of {shard.path} (off by {off_us / 1e3:.0f} ms)"
                )
        return meta

    def _pose(self, frame: int) -> npt.NDArray[np.float64]:
        shard, sample = self._place(frame)
        return np.array(shard.meta(sample)["global_from_ego"], np.float64)

    def motion(self, before: int, after: int) -> npt.NDArray[np.float32]:
        """Return the motion of the ego poses."""
        return ego_motion(self._pose(before), self._pose(after))


def _runs(records: Sequence[Record]) -> Iterator[range]:
    """Yield the samples of shards that follow each other."""
    begin = total = 0
    for number, record in enumerate(records):
        if number and records[number - 1].end != record.first:
            yield range(begin, total)
            begin = total
        total += record.samples
    yield range(begin, total)


def shard_readers(folder: Path) -> list[FrameReader]:
    """Return the logs of an export in the layout webdataset.

    Raises ``DataError`` for an export without images or without a map that clips need.
    """
    options = export_options(folder)
    if not options.get("images"):
        raise DataError(f"expected shards with images, found an export without --images: {folder}")
    kinds = options.get("maps") or []
    if missing := [kind for kind in ("color", "depth", "boxes") if kinds and kind not in kinds]:
        raise DataError(f"expected shards with the map {missing[0]}, found {', '.join(kinds)}: {folder}")
    options = {**options, "depth_bins": {**BINS, **options.get("depth_bins", {})}}
    by_log = groupby(records_in(folder), key=lambda record: record.log)
    return [ShardReader(folder, list(records), options) for _, records in by_log]
