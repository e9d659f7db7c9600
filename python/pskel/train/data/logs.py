"""Logs that ``pskel.Log`` opens: images, poses and cameras of their key frames."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from ..errors import DataError, first_line
from .captions import read_captions
from .images import reduced, rgb_tensor
from .numbers import camera_numbers, ego_motion
from .reader import FrameReader, Frames
from .recipe import size_of

if TYPE_CHECKING:
    import pskel

__all__ = ["LogReader", "LogMaps", "Opened", "is_town", "log_images", "mounted_cameras", "open_log"]

_OPEN_LOGS = 2
Array = npt.NDArray[Any]


class LogMaps(NamedTuple):
    """Maps of a frame over all cameras, ``[V, H, W, ..]``."""

    color: npt.NDArray[np.uint8]
    bins: npt.NDArray[np.int16]
    boxes: npt.NDArray[np.uint8]
    map: npt.NDArray[np.uint8]


def is_town(text: str) -> bool:
    """Return whether a log is a synthetic town, by the text that opens it. Its images can be rendered from any pose."""
    return text.startswith("town:")


def open_log(text: str) -> pskel.Log:
    """Open a log. Raises ``DataError``."""
    import pskel

    if not hasattr(pskel, "Log"):
        raise DataError(f"reading logs needs the compiled part of pskel, which this installation lacks: {text}")
    try:
        return pskel.Log(text)
    except (pskel.Error, ValueError) as error:
        raise DataError(f"the log cannot be opened: {first_line(error)}: {text}") from error


def mounted_cameras(log: pskel.Log, frame: int) -> npt.NDArray[np.float64]:
    """Return ``ego_from_camera`` of the cameras at a key frame, ``[V, 4, 4]``: the mounting positions.

    The cameras of a key frame are where their images were taken, some milliseconds apart; at an instant they are
    together.
    """
    scene = log.at(log.times_us[frame])
    mounted: npt.NDArray[np.float64] = np.linalg.inv(scene.ego) @ np.linalg.inv(scene.camera_from_global)
    return mounted


def log_images(log: pskel.Log, scene: pskel.Scene, recipe: Mapping[str, Any], *, town: bool) -> npt.NDArray[np.uint8]:
    """Return the images of a scene, ``uint8 [V, H, W, 3]`` of the recipe's ``size``; a town's are rendered at
    ``drawn``.

    Raises ``DataError`` if there are none.
    """
    import pskel

    size = size_of(recipe["size"], "recipe.size")
    try:
        if town:
            return reduced(log.images(scene, size_of(recipe["drawn"], "recipe.drawn")), size)
        return log.images(scene, size)
    except pskel.Error as error:
        raise DataError(f"a clip needs images: {first_line(error)} (frame {scene.name} of {log.name})") from error


class Opened(NamedTuple):
    """Something of a process, which a fork must not use."""

    process: int
    value: Any


class LogReader(FrameReader):
    """The key frames of a log. A subclass has the maps."""

    def __init__(self, text: str, recipe: Mapping[str, Any], captions: str | None) -> None:
        """Open a log, with the captions of a file."""
        self.text = self.source = text
        self.recipe = recipe
        log = self.opened_log()
        self.captions = None if captions is None else read_captions(captions).of(log)
        self.log = log.name
        if not len(log):
            raise DataError(f"expected a log with frames, found none: {text}")
        self.times_us = np.array(log.times_us, np.int64)
        scene = log[0]
        self.names = tuple(scene.cameras)
        self._sizes = np.array(scene.sizes, np.int64)
        self.runs = [range(len(log))]
        interval_us = float(np.median(np.diff(self.times_us))) if len(log) > 1 else 0.0
        self.hz = 1e6 / interval_us if interval_us > 0 else 0.0

    @abstractmethod
    def maps(self, scene: pskel.Scene, frame: int) -> LogMaps:
        """Return the maps of a scene."""

    def scene(self, log: pskel.Log, frame: int) -> pskel.Scene:
        """Return the scene at a key frame."""
        return log[frame]

    def opened_log(self) -> pskel.Log:
        """Return the log, opened in this process; the least recently used ones are closed."""
        opened = _logs.pop(self.text, None)
        if opened is None or opened.process != os.getpid():
            opened = Opened(os.getpid(), open_log(self.text))
        while len(_logs) >= _OPEN_LOGS:
            _logs.popitem(last=False)
        _logs[self.text] = opened
        log: pskel.Log = opened.value
        return log

    def read(self, frames: Sequence[int], views: Sequence[int]) -> Frames:
        """Read the images of frames, and their maps."""
        log = self.opened_log()
        rows = [self._frame(log, frame, list(views)) for frame in frames]

        def rgb(index: int) -> torch.Tensor:
            return rgb_tensor([row[index] for row in rows])

        assert self.times_us is not None
        return Frames(
            color=rgb(0),
            bins=torch.from_numpy(np.stack([row[1] for row in rows])),
            boxes=rgb(2),
            map=rgb(3),
            images=rgb(4),
            cameras=torch.from_numpy(np.stack([row[5] for row in rows])),
            global_from_ego=np.stack([self.scene(log, frame).ego for frame in frames]),
            t_us=self.times_us[list(frames)],
            original_sizes=self._sizes[list(views)],
            captions=self.captions_of(frames, views),
        )

    def _frame(self, log: pskel.Log, frame: int, views: list[int]) -> tuple[Array, ...]:
        scene = self.scene(log, frame)
        maps = self.maps(scene, frame)
        images = log_images(log, scene, self.recipe, town=is_town(self.text))
        numbers = camera_numbers(mounted_cameras(log, frame), scene.intrinsics, np.array(scene.sizes))
        return tuple(array[views] for array in (*maps, images, numbers))

    def motion(self, before: int, after: int) -> npt.NDArray[np.float32]:
        """Return the motion of the ego poses."""
        log = self.opened_log()
        return ego_motion(self.scene(log, before).ego, self.scene(log, after).ego)


_logs: OrderedDict[str, Opened] = OrderedDict()
