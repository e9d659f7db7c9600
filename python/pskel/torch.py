"""Datasets for PyTorch: condition tensors, images and camera parameters of clips.

Worker processes open their own logs and devices, so any start method works as long as the parent has opened no device
before it forks. If it has, workers raise ``RenderError``; start them with ``multiprocessing_context="forkserver"`` or
``"spawn"``.
"""

from __future__ import annotations

import math
import os
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

try:
    import torch
    from torch.utils.data import Dataset, IterableDataset, get_worker_info
except ImportError as error:
    raise ImportError("pskel.torch needs PyTorch: pip install 'pskel[torch]'") from error

from . import Captions, Log, Renderer, Scene, Skeleton
from ._types import RenderKeywords, check_names
from .train.data.logs import mounted_cameras
from .train.data.numbers import camera_numbers, ego_motion
from .train.data.reader import frames_apart, is_steady

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["Clip", "ClipSource", "ConditionDataset", "ConditionStream"]

Augment = Callable[[Scene, np.random.Generator], Scene]
CaptionOf = Callable[[str, int, str], str]
"""Caption of a log, a frame by its number in the log, and a camera by its channel."""


class ClipSource(NamedTuple):
    """A log, as the text that ``Log`` opens (not its ``Log.name``), and the folder of its skeleton."""

    log: str
    skeleton: str


class Clip(NamedTuple):
    """Frames of a clip: index of the source, first key frame."""

    source: int
    first: int


class _Opened(NamedTuple):
    log: Log
    renderer: Renderer


class _Clips:
    """Clips of logs, with a renderer per log and process."""

    def __init__(
        self,
        sources: Sequence[tuple[str, str]],
        *,
        out_size: Sequence[int],
        frames: int = 1,
        stride: int = 1,
        every: int | None = None,
        hz: float | None = None,
        images: bool = True,
        numbers: bool = False,
        captions: CaptionOf | str | os.PathLike[str] | None = None,
        augment: Augment | None = None,
        augment_assets: int | None = None,
        seed: int = 0,
        open_logs: int = 2,
        **renderer: Unpack[RenderKeywords],
    ) -> None:
        if frames < 1 or stride < 1 or open_logs < 1:
            found = f"{frames}, {stride}, {open_logs}"
            raise ValueError(f"expected frames, stride and open_logs of 1 or more, found {found}")
        if every is not None and hz is not None:
            raise ValueError(f"expected every or hz, found both: {every} and {hz}")
        if every is not None and every < 1:
            raise ValueError(f"expected every of 1 or more, found {every}")
        if hz is not None and not (math.isfinite(hz) and hz > 0):
            raise ValueError(f"expected hz above 0, found {hz}")
        check_names(renderer, RenderKeywords)
        pairs = [tuple(source) if not isinstance(source, str) else (source,) for source in sources]
        if wrong := [pair for pair in pairs if len(pair) != 2]:
            raise TypeError(f"expected pairs of a log and the folder of its skeleton, found {wrong[0]}")
        self.sources = [ClipSource(log, os.fspath(skeleton)) for log, skeleton in pairs]
        self.out_size = out_size
        self.frames = frames
        self.stride = stride
        self.images = images
        self.numbers = numbers
        self.augment = augment
        self.augment_assets = augment_assets
        self.seed = seed
        self.epoch = 0
        self._open_logs = open_logs
        self._options = renderer
        self._opened: OrderedDict[int, _Opened] = OrderedDict()
        self._process = os.getpid()
        self._caption_of = captions if callable(captions) else None
        of_file = None if captions is None or callable(captions) else Captions(captions)
        times, texts = [], []
        for source in self.sources:
            log = _checked(source)
            times.append(np.array(log.times_us, np.int64))
            texts.append(None if of_file is None else of_file.of(log))
        self._captions = None if of_file is None else texts
        self._every = [
            every or 1 if hz is None else _every(all_us, hz, source.log) for source, all_us in zip(self.sources, times)
        ]
        self.clips = [
            Clip(source, first)
            for source, (all_us, step) in enumerate(zip(times, self._every))
            for first in range(0, len(all_us) - (frames - 1) * step, stride)
            if hz is None or is_steady(all_us[first : first + (frames - 1) * step + 1 : step], hz)
        ]
        if not self.clips:
            least = (frames - 1) * min(self._every, default=1) + 1
            steady = "" if hz is None else f" without gaps at {hz} Hz"
            counts = [len(all_us) for all_us in times]
            raise ValueError(f"expected a log of at least {least} key frames{steady}, found logs of {counts}")

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch, which changes the random numbers of ``augment``."""
        self.epoch = epoch

    def open(self, source: int) -> _Opened:
        """Open a log and its renderer in this process; the least recently used ones are closed."""
        if self._process != os.getpid():  # a fork must not use the devices of its parent
            self._opened = OrderedDict()
            self._process = os.getpid()
        opened = self._opened.pop(source, None)
        if opened is None:
            while len(self._opened) >= self._open_logs:
                self._opened.popitem(last=False)[1].renderer.close()
            text, skeleton = self.sources[source]
            log = Log(text)
            renderer = Renderer(
                Skeleton(skeleton),
                out_size=self.out_size,
                maps=["tensor"],
                log=log.name,
                augment=self.augment_assets,
                **self._options,
            )
            opened = _Opened(log, renderer)
        self._opened[source] = opened
        return opened

    def item(self, index: int) -> dict[str, Any]:
        """Render the clip with an index."""
        source, first = self.clips[index]
        log, renderer = self.open(source)
        frames = [first + i * self._every[source] for i in range(self.frames)]
        scenes = [self._augmented(log[frame], index) for frame in frames]
        maps = list(renderer.render_all(scenes))
        item = {
            "points": np.stack([frame["points"] for frame in maps]),
            "layout": np.stack([frame["layout"] for frame in maps]),
            "intrinsics": np.stack([_scaled(scene, self.out_size) for scene in scenes]),
            "camera_from_global": np.stack([scene.camera_from_global for scene in scenes]),
            "global_from_ego": np.stack([scene.ego for scene in scenes]),
            "t_us": np.array([scene.t_us for scene in scenes]),
        }
        if self.images:
            images = np.stack([log.images(scene, self.out_size) for scene in scenes])
            item["images"] = np.ascontiguousarray(images.transpose(0, 1, 4, 2, 3))
        if self.numbers:
            before = first - self._every[source]
            previous = self._augmented(log[before], index).ego if before >= 0 else None
            poses = [previous, *(scene.ego for scene in scenes)]
            item["action"] = np.stack([ego_motion(a, b) for a, b in zip(poses, poses[1:]) if b is not None])
            item["cameras"] = np.stack([_numbers(log, frame, scene) for frame, scene in zip(frames, scenes)])
        tensors: dict[str, Any] = {name: torch.from_numpy(array) for name, array in item.items()}
        cameras = scenes[0].cameras
        if self._caption_of is not None:
            tensors["captions"] = [[self._caption_of(log.name, frame, name) for name in cameras] for frame in frames]
        elif self._captions is not None:
            texts = self._captions[source]
            tensors["captions"] = [[""] * len(cameras) if texts is None else texts[frame] for frame in frames]
        return tensors

    def _augmented(self, scene: Scene, index: int) -> Scene:
        # The same random numbers for all frames, so that a clip moves as one.
        if self.augment is None:
            return scene
        return self.augment(scene, np.random.default_rng((self.seed, self.epoch, index)))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": OrderedDict()}


def _checked(source: ClipSource) -> Log:
    """Open a log, which the skeleton must contain."""
    log, skeleton = Log(source.log), Skeleton(source.skeleton)
    if log.name not in skeleton.logs:
        found = ", ".join(skeleton.logs)
        raise ValueError(f"expected a skeleton of log {log.name}, found one of {found}: {source.skeleton}")
    return log


def _every(times_us: np.ndarray[Any, np.dtype[np.int64]], hz: float, log: str) -> int:
    """Return which key frame is the next one of a clip at a rate. Raises ``ValueError`` if the rates do not fit."""
    if len(times_us) < 2:
        return 1
    rate = 1e6 / float(np.median(np.diff(times_us)))
    every = frames_apart(rate, hz)
    if every is None:
        raise ValueError(f"expected hz that divides the rate of the key frames, {rate:.4g} Hz, found {hz}: {log}")
    return every


def _scaled(scene: Scene, size: Sequence[int]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Intrinsics of the cameras at a size, ``[V, 3, 3]``."""
    scaled = scene.intrinsics
    for camera, (height, width) in enumerate(scene.sizes):
        scaled[camera, 0] *= size[1] / width
        scaled[camera, 1] *= size[0] / height
    return scaled


def _numbers(log: Log, frame: int, scene: Scene) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Camera numbers of a scene; a scene of other cameras than the log's has their positions at its own time."""
    if scene.cameras == log[frame].cameras:
        mounted = mounted_cameras(log, frame)
    else:
        mounted = np.linalg.inv(scene.ego) @ np.linalg.inv(scene.camera_from_global)
    return camera_numbers(mounted, scene.intrinsics, np.array(scene.sizes))


class ConditionDataset(_Clips, Dataset[dict[str, Any]]):
    """Clips of logs as a map-style dataset.

    ``sources`` are pairs of a log, as the text that ``Log`` opens, and a skeleton folder that contains this
    log, possibly among others. An item has T = ``frames`` key frames, V cameras and maps of ``out_size``
    (height, width):

    - ``points`` ``float32 [T, V, 20, H, W]`` and ``layout`` ``float32 [T, V, 6, H, W]``: the network input,
    - ``images`` ``uint8 [T, V, 3, H, W]`` (unless ``images=False``): recorded images, or rendered ones of a town,
    - ``intrinsics`` ``float64 [T, V, 3, 3]`` at ``out_size``, ``camera_from_global`` ``float64 [T, V, 4, 4]``,
      ``global_from_ego`` ``float64 [T, 4, 4]``, ``t_us`` ``int64 [T]``,
    - with ``numbers=True``, ``cameras`` ``float32 [T, V, 16]``: the upper three rows of the mounted ``ego_from_camera``
      (m), then fx/W, fy/H, cx/W, cy/H; and ``action`` ``float32 [T, 3]``: forward, left (m) and yaw (rad) since the
      previous frame of the same spacing, also that before the clip; zeros without one,
    - with ``captions``, ``captions``: a list of T lists of V texts. ``captions`` is a JSON file for ``pskel.Captions``,
      such as OpenDWM publishes for nuScenes, and *Point as Skeleton* for nuPlan; or a function of log name,
      frame number and camera. Logs without one have empty texts.

    Clips begin every ``stride`` key frames. Their frames are consecutive key frames, every ``every``-th one, or key
    frames at the rate ``hz``, which must divide the key frame rate. With ``hz``, clips across gaps of the log are
    skipped. ``augment(scene, generator)`` changes a scene with random numbers that depend on ``seed``, epoch
    (``set_epoch``) and index only; recorded images do not follow a moved ego. ``augment_assets`` is the seed for
    degrading a share of the assets, the option ``augment`` of ``pskel.Renderer``. Other keyword arguments are passed to
    ``pskel.Renderer``, except ``maps`` and ``log``. Raises ``ValueError`` for a skeleton of other logs, for a rate that
    does not divide a log's rate, and if no log is as long as a clip, and ``pskel.Error`` for another file of captions.
    """

    def __len__(self) -> int:
        return len(self.clips)

    def __getitem__(self, index: int) -> dict[str, Any]:
        if not -len(self.clips) <= index < len(self.clips):
            raise IndexError(f"expected a clip below {len(self.clips)}, found {index}")
        return self.item(index % len(self.clips))


class ConditionStream(_Clips, IterableDataset[dict[str, Any]]):
    """Clips of logs in order, as an iterable dataset: the items of ``ConditionDataset``.

    Workers, and the processes of ``torch.distributed``, share the clips in turn.
    """

    def __iter__(self) -> Iterator[dict[str, Any]]:
        worker = get_worker_info()
        workers, number = (1, 0) if worker is None else (worker.num_workers, worker.id)
        ranks, rank = 1, 0
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            ranks, rank = torch.distributed.get_world_size(), torch.distributed.get_rank()
        for index in range(rank * workers + number, len(self.clips), ranks * workers):
            yield self.item(index)
