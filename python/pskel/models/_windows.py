"""Windows of noisy latents, as denoisers of all networks take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ._condition import LAYOUT_CHANNELS, FrameCondition

__all__ = ["as_tensor", "expect_finite", "expect_window"]

_Array = np.ndarray[Any, np.dtype[np.float32]]


def as_tensor(array: npt.ArrayLike) -> Tensor:
    """Copy an array as ``float32`` on the CPU."""
    # Convolutions round according to the order of values in memory, so it is always the same.
    return torch.tensor(np.ascontiguousarray(array, np.float32))


def expect_window(
    sample: Tensor, levels: Tensor, conditions: Sequence[FrameCondition], shape: tuple[int, ...], size: Sequence[int]
) -> None:
    """Raise ``ValueError`` unless latents ``[L, *shape]``, levels ``[L]`` and conditions of ``size`` fit each other."""
    frames, views = len(conditions), shape[0]
    if tuple(sample.shape) != (frames, *shape):
        raise ValueError(f"expected latents of {[frames, *shape]}, found {list(sample.shape)}")
    if tuple(levels.shape) != (frames,):
        raise ValueError(f"expected timesteps of [{frames}], found {list(levels.shape)}")
    for condition in conditions:
        found = condition.layout.array.shape
        if found != (views, LAYOUT_CHANNELS, *size):
            raise ValueError(f"expected layout of {[views, LAYOUT_CHANNELS, *size]}, found {list(found)}")


def expect_finite(prediction: _Array) -> None:
    """Raise ``ValueError`` for a prediction with infinite or undefined values."""
    if not np.isfinite(prediction).all():
        raise ValueError("expected a finite prediction, found infinite or undefined values (is bf16 used?)")
