"""Conditions that a generator sends once (docs/src/reference/denoiser.md#conditions-by-number)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .._texts import listed
from ._condition import FrameCondition

__all__ = ["TYPES", "SentFrames"]

_Array = npt.NDArray[Any]
TYPES = ("F32", "U8", "U16")
"""Types of all tensors."""
_DEPTH_CHANNELS = 17


class SentFrames:
    """Conditions of the last call, by number."""

    def __init__(self, views: int, size: tuple[int, int]) -> None:
        self._pixels = (views, *size)
        self._kept: dict[int, FrameCondition] = {}

    def window(self, texts: Mapping[str, str], tensors: Mapping[str, _Array], frames: int) -> list[FrameCondition]:
        """Return the conditions of a call's window; all others are forgotten.

        Raises ``ValueError``, which names a missing or wrong text or tensor, and numbers that are not known.
        """
        numbers, new = _numbers(texts, "frames"), _numbers(texts, "new")
        if len(numbers) != frames:
            raise ValueError(f"expected frames as a list of {frames} numbers in the call, found {texts['frames'][:200]}")
        known = {**self._kept, **dict(zip(new, self._received(texts, tensors, len(new))))}
        if unknown := sorted(set(numbers) - set(known)):
            raise ValueError(f"expected frames that were sent, found the numbers {', '.join(map(str, unknown))[:200]}")
        self._kept = {number: known[number] for number in numbers}
        return [known[number] for number in numbers]

    def _received(self, texts: Mapping[str, str], tensors: Mapping[str, _Array], count: int) -> list[FrameCondition]:
        """Conditions in the call."""
        if count == 0:
            return []
        without = listed(texts, "without", "the call")
        if not all(isinstance(part, str) for part in without):
            raise ValueError(f"expected without as a list of texts in the call, found {texts['without'][:200]}")
        views = self._pixels[0]
        color, boxes, road = (_tensor(tensors, name, np.uint8, (count, *self._pixels, 3)) for name in ("color", "boxes", "map"))
        bins = _tensor(tensors, "bins", np.uint16, (count, *self._pixels))
        values = tensors.get("depth_values")
        if values is None or values.dtype != np.float32 or values.ndim != 2 or values.shape[0] != _DEPTH_CHANNELS:
            raise ValueError(f"expected the tensor depth_values float32 [{_DEPTH_CHANNELS}, bins + 1], found {_shown(values)}")
        if bins.max(initial=0) >= values.shape[1]:
            raise ValueError(f"expected bins below {values.shape[1]} in the call, found {bins.max()}")
        action = _tensor(tensors, "action", np.float32, (count, 3))
        cameras = _tensor(tensors, "cameras", np.float32, (count, views, 16))
        frames = []
        for i in range(count):
            points = np.concatenate([_levels(color[i]), values[0][bins[i]][:, None]], axis=1)
            layout = np.concatenate([_levels(boxes[i]), _levels(road[i])], axis=1)
            frames.append(FrameCondition.create(points, layout, action[i], cameras[i]).without(*without))
        return frames


def _levels(image: _Array) -> npt.NDArray[np.float32]:
    """Levels ``[V, 3, H, W]`` from 0 to 1 of images ``uint8 [V, H, W, 3]``."""
    levels: npt.NDArray[np.float32] = image.transpose(0, 3, 1, 2).astype(np.float32) / np.float32(255)
    return levels


def _numbers(texts: Mapping[str, str], name: str) -> list[int]:
    numbers = listed(texts, name, "the call")
    is_number: Callable[[Any], bool] = lambda value: type(value) is int and value >= 0  # noqa: E731
    if not all(map(is_number, numbers)):
        raise ValueError(f"expected {name} as a list of numbers in the call, found {texts[name][:200]}")
    return numbers


def _tensor(tensors: Mapping[str, _Array], name: str, kind: Any, shape: tuple[int, ...]) -> _Array:
    found = tensors.get(name)
    if found is None or found.dtype != kind or found.shape != shape:
        raise ValueError(f"expected the tensor {name} {np.dtype(kind)} {list(shape)} in the call, found {_shown(found)}")
    return found


def _shown(tensor: _Array | None) -> str:
    return "none" if tensor is None else f"{tensor.dtype} {list(tensor.shape)}"
