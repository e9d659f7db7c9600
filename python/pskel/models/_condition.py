"""Condition of a frame."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .._arrays import numbers

if TYPE_CHECKING:
    from pskel import Scene

__all__ = [
    "DROPPED_MOTION",
    "LAYOUT_CHANNELS",
    "NO_COLOR",
    "NO_DEPTH",
    "POINT_CHANNELS",
    "ConditionMaps",
    "FrameCondition",
    "compute_keys",
]

_Array = np.ndarray[Any, np.dtype[np.float32]]

POINT_CHANNELS, LAYOUT_CHANNELS = 4, 6
NO_COLOR, NO_DEPTH = 0.1255, -1.0
"""Dropped color or layout, and dropped depth."""
DROPPED_MOTION = -1000.0
"""Each number of a dropped motion, as input and as speed and steering."""
_THREADS = 8
_PARTS = ("layout", "action", "color", "depth")


class ConditionMaps:
    """Maps of a frame over all cameras, ``float32 [V, C, H, W]``: a read-only copy."""

    def __init__(self, array: npt.ArrayLike) -> None:
        self.array: _Array = np.array(array, np.float32, order="C")
        self.array.flags.writeable = False

    @cached_property
    def key(self) -> tuple[tuple[int, ...], bytes]:
        """Shape and digest: equal only for equal maps."""
        return self.array.shape, hashlib.blake2b(self.array.data, digest_size=32).digest()


def compute_keys(maps: Iterable[ConditionMaps]) -> None:
    """Compute the keys of maps in parallel."""
    different = {id(x): x for x in maps if "key" not in vars(x)}
    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(lambda x: x.key, different.values()))  # hashlib releases the interpreter lock


@dataclass(frozen=True, eq=False)
class FrameCondition:
    """Condition of a frame, as ``Denoiser`` takes it. ``create`` and ``from_scene`` make one."""

    points: ConditionMaps
    """Color (3, 0 to 1) and depth (0 to 1, -1 where empty), ``[V, 4, H, W]``."""
    layout: ConditionMaps
    """Boxes and map, RGB of 0 to 1, ``[V, 6, H, W]``."""
    action: _Array
    """Motion of the ego since the previous frame: forward, left (m), yaw (rad)."""
    cameras: _Array
    """``[V, 16]``: upper three rows of ``ego_from_camera``, focal lengths and principal point over width and height."""
    prompt: str | tuple[str, ...] = ""
    """Text of all cameras, or of each."""
    is_reference: bool = False
    """Whether the frame is finished, so that its prediction is not used. The video network ignores it."""

    @classmethod
    def create(
        cls,
        points: npt.ArrayLike,
        layout: npt.ArrayLike,
        action: npt.ArrayLike,
        cameras: npt.ArrayLike,
        prompt: str | Sequence[str] = "",
        is_reference: bool = False,
    ) -> FrameCondition:
        """Copy arrays of the denoiser protocol, of one frame.

        ``points`` may have more than 4 channels; the network ignores the others. Raises ``ValueError`` for
        arrays of other shapes, and for other than one prompt or one per camera.
        """
        point_maps, layout_maps = numbers(points), numbers(layout)
        motion, poses = numbers(action).astype(np.float32), numbers(cameras).astype(np.float32)
        views, size = layout_maps.shape[:1], layout_maps.shape[2:]
        if layout_maps.ndim != 4 or layout_maps.shape[1] != LAYOUT_CHANNELS:
            raise ValueError(f"expected layout of [V, {LAYOUT_CHANNELS}, H, W], found {list(layout_maps.shape)}")
        is_same = point_maps.ndim == 4 and (point_maps.shape[:1], point_maps.shape[2:]) == (views, size)
        if not is_same or point_maps.shape[1] < POINT_CHANNELS:
            expected = [*views, "20", *size]
            raise ValueError(f"expected points of [{', '.join(map(str, expected))}], found {list(point_maps.shape)}")
        for name, array, shape in (("action", motion, (3,)), ("cameras", poses, (*views, 16))):
            if array.shape != shape:
                raise ValueError(f"expected {name} of {list(shape)}, found {list(array.shape)}")
        maps = ConditionMaps(point_maps[:, :POINT_CHANNELS]), ConditionMaps(layout_maps)
        return cls(*maps, motion, poses).told(prompt, is_reference)

    def told(self, prompt: str | Sequence[str], is_reference: bool) -> FrameCondition:
        """Return the condition with other texts; raises ``ValueError`` for other than one prompt or one per camera."""
        texts = prompt if isinstance(prompt, str) else tuple(prompt)
        if not isinstance(texts, str) and len(texts) != len(self.cameras):
            raise ValueError(f"expected a prompt, or one for each of {len(self.cameras)} cameras, found {len(texts)}")
        return replace(self, prompt=texts, is_reference=is_reference)

    @property
    def prompts(self) -> tuple[str, ...]:
        """Text of each camera."""
        return (self.prompt,) * len(self.cameras) if isinstance(self.prompt, str) else self.prompt

    @classmethod
    def from_scene(
        cls,
        scene: Scene,
        maps: Mapping[str, Any],
        previous: npt.ArrayLike | None = None,
        prompt: str | Sequence[str] = "",
        is_reference: bool = False,
    ) -> FrameCondition:
        """Describe a scene by its maps, as rendered by ``Renderer(.., maps=["tensor"])``.

        ``previous`` is ``scene.ego`` of the previous frame, ``[4, 4]``; without it, the ego has not moved.
        Camera positions are relative to ``scene.ego``. In a simulation, these are the mounting positions; in
        a log, the positions at the images' own times, some milliseconds earlier or later.
        """
        motion = np.linalg.inv(numbers(previous).astype(np.float64)) @ scene.ego if previous is not None else np.eye(4)
        action = [motion[0, 3], motion[1, 3], np.arctan2(motion[1, 0], motion[0, 0])]
        ego_from_camera = np.linalg.inv(scene.ego) @ np.linalg.inv(scene.camera_from_global)
        height, width = np.array(scene.sizes, np.float64).T
        k = scene.intrinsics
        fractions = np.stack([k[:, 0, 0] / width, k[:, 1, 1] / height, k[:, 0, 2] / width, k[:, 1, 2] / height], axis=1)
        cameras = np.concatenate([ego_from_camera[:, :3].reshape(-1, 12), fractions], axis=1)
        return cls.create(maps["points"], maps["layout"], action, cameras, prompt, is_reference)

    def without(self, *parts: str) -> FrameCondition:
        """Drop parts for guidance: ``layout``, ``action`` (with the prompt), ``color``, ``depth``.

        Raises ``ValueError`` for another name.
        """
        if unknown := sorted(set(parts) - set(_PARTS)):
            raise ValueError(f"expected parts of {', '.join(_PARTS)}, found {', '.join(unknown)}")
        left = self
        if "layout" in parts:
            left = replace(left, layout=_filled(self.layout.array.shape, NO_COLOR))
        if "action" in parts:
            left = replace(left, action=np.full_like(self.action, DROPPED_MOTION), prompt="")
        if "color" in parts or "depth" in parts:
            points = self.points.array.copy()
            if "color" in parts:
                points[:, :3] = NO_COLOR
            if "depth" in parts:
                points[:, 3:] = NO_DEPTH
            left = replace(left, points=ConditionMaps(points))
        return left


@lru_cache(maxsize=2)
def _filled(shape: tuple[int, ...], value: float) -> ConditionMaps:
    return ConditionMaps(np.full(shape, value, np.float32))
