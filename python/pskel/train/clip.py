"""A training clip: condition maps, images, camera and motion numbers of some frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

__all__ = ["Clip"]


@dataclass(frozen=True)
class Clip:
    """L frames of V cameras. All tensors are on the CPU."""

    color: Tensor
    """``uint8 [L, V, 3, H, W]``, black where no point is."""
    bins: Tensor
    """Depth, ``int16 [L, V, H, W]``: 0 where no point is, else 1 and more."""
    boxes: Tensor
    """``uint8 [L, V, 3, H, W]``."""
    map: Tensor
    """``uint8 [L, V, 3, H, W]``, zeros without an HD map."""
    images: Tensor
    """``uint8 [L, V, 3, H, W]``, without lens distortion."""
    cameras: Tensor
    """``float32 [L, V, 16]``: rows 0 to 2 of ``ego_from_camera`` (m), then fx/W, fy/H, cx/W, cy/H."""
    action: Tensor
    """``float32 [L, 3]``: forward, left (m) and yaw (rad) since the previous frame. Zeros where no previous frame is
    known, as in the first one of a log."""
    global_from_ego: Tensor
    """``float64 [L, 4, 4]``, m."""
    t_us: Tensor
    """Absolute times, ``int64 [L]``, microseconds."""
    original_sizes: Tensor
    """Height and width of the recorded images, ``int64 [V, 2]``, pixels."""
    names: tuple[str, ...]
    """Channels of the cameras."""
    captions: tuple[tuple[str, ...], ...]
    """Caption of each frame and camera, ``[L][V]``; empty texts without."""
    log: str
    """Name of the log."""
    frame: int
    """Number of the first frame in the log."""
    hz: float
    """Rate of the clip's frames, per second."""
    recipe: Mapping[str, Any]
    """How the maps were rendered: the keys of a recipe of the denoiser protocol."""
