"""Conditions as the network takes them."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .config import CELL, TOKEN, WORK
from .fill import fill

OCTAVES = 4
RAY = 3 + 6 * OCTAVES
"""Numbers of a token's ray: its direction in the ego frame, and sines and cosines of 1, 2, 4 and 8 times it."""
EGO = 4
"""Numbers of the ego motion: forward, left, turn, and whether it is known."""
EGO_SCALES = (2.0, 0.5, 0.1)
"""Typical ego motion per frame, its divisors: meters forward, meters to the left, radians."""
NO_COLOR = 0.1255
"""Color of all pixels where color was dropped."""
NO_ACTION = -1000.0
"""Ego motion where it was dropped."""
CENTER = 0.5
GAIN = 4.0
"""Filled colors and depths are shown as ``GAIN (value - CENTER)``, about as large as the other numbers."""


class Maps(NamedTuple):
    """Condition maps of images: colors 0 to 1, depth 0 to 1 and -1 where it is not known."""

    color: Tensor
    """``[N, 3, H, W]``, black or 0.1255 where it is not known."""
    depth: Tensor
    """``[N, 1, H, W]``."""
    boxes: Tensor
    """``[N, 3, H, W]``."""
    map: Tensor
    """``[N, 3, H, W]``."""
    cameras: Tensor
    """``[N, 16]``: ego from camera (three rows of four), then fx/W, fy/H, cx/W, cy/H."""

    def known(self) -> tuple[Tensor, Tensor]:
        """Return where color and depth are known, ``[N, 1, H, W]``, 0 or 1."""
        # Three comparisons: reductions over so few channels are slow.
        red, green, blue = self.color.chunk(3, 1)
        is_black = (red == 0) & (green == 0) & (blue == 0)
        is_dropped = (red == NO_COLOR) & (green == NO_COLOR) & (blue == NO_COLOR)
        return (~(is_black | is_dropped)).to(self.color.dtype), (self.depth >= 0).to(self.color.dtype)


def full_planes(maps: Maps) -> Tensor:
    """Return the numbers of pixels, ``[N, 16, H, W]``.

    These are filled color and depth around 0 (``GAIN``), whether color and depth are known, boxes, map, the direction of the ray in the
    ego frame, and a zero.
    """
    has_color, has_depth = maps.known()
    color, depth = fill(maps.color, has_color), fill(maps.depth, has_depth)
    return _planes(color, depth, has_color, has_depth, maps.boxes, maps.map, maps.cameras)


def work_planes(maps: Maps) -> Tensor:
    """Return the numbers of 4x4 pixels, ``[N, 16, H/4, W/4]``: means of the known pixels, with holes filled after that."""
    has_color, has_depth = maps.known()
    (color, color_share), (depth, depth_share) = _reduced(maps.color, has_color), _reduced(maps.depth, has_depth)
    layouts = F.avg_pool2d(maps.boxes, WORK), F.avg_pool2d(maps.map, WORK)
    return _planes(color, depth, color_share, depth_share, *layouts, maps.cameras)


def cells(work: Tensor) -> Tensor:
    """Return the mean colors of 16x16 pixels, 0 to 1, ``[N, 3, h, w]``, of ``work_planes``."""
    return F.avg_pool2d(work[:, :3], CELL // WORK) / GAIN + CENTER


def _reduced(values: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Return the filled means of 4x4 pixels, and the share of pixels that are known."""
    share = F.avg_pool2d(known, WORK)
    means = F.avg_pool2d(values * known, WORK) / share.clamp(min=1e-6)
    return fill(means, (share > 0).to(values.dtype)), share


def _planes(color: Tensor, depth: Tensor, has_color: Tensor, has_depth: Tensor, boxes: Tensor, map: Tensor, cameras: Tensor) -> Tensor:
    rays = directions(cameras, *color.shape[2:])
    zero = torch.zeros_like(depth)
    return torch.cat([GAIN * (color - CENTER), GAIN * (depth - CENTER), has_color, has_depth, boxes, map, rays, zero], 1)


def directions(cameras: Tensor, height: int, width: int) -> Tensor:
    """Return the directions in the ego frame of the rays through places of images, ``[N, 3, height, width]``."""
    numbers = cameras.double()
    fx, fy, cx, cy = (numbers[:, i, None, None] for i in range(12, 16))
    y = (torch.arange(height, dtype=torch.float64, device=cameras.device)[None, :, None] + 0.5) / height
    x = (torch.arange(width, dtype=torch.float64, device=cameras.device)[None, None] + 0.5) / width
    right, low = ((x - cx) / fx).expand(-1, height, -1), ((y - cy) / fy).expand(-1, -1, width)
    length = (right.square() + low.square() + 1).sqrt()
    rays = torch.stack([right / length, low / length, 1 / length], 1)
    rotations = numbers[:, :12].reshape(-1, 3, 4)[:, :, :3]
    return torch.einsum("nij,njhw->nihw", rotations, rays).to(cameras.dtype)


def token_rays(cameras: Tensor, height: int, width: int) -> Tensor:
    """Return the rays of tokens, ``[N, H/32, W/32, 27]``, for images of some size."""
    rays = directions(cameras.double(), height // TOKEN, width // TOKEN).permute(0, 2, 3, 1)
    parts = [rays]
    for octave in range(OCTAVES):
        parts += [(2**octave * rays).sin(), (2**octave * rays).cos()]
    return torch.cat(parts, -1).to(cameras.dtype)


def ego_numbers(action: Tensor) -> Tensor:
    """Return the ego motion ``[..., 3]`` as the network takes it, ``[..., 4]``; zeros if it was dropped."""
    known = (action != NO_ACTION).all(-1, keepdim=True)
    scaled = torch.cat([action / action.new_tensor(EGO_SCALES), torch.ones_like(action[..., :1])], -1)
    return torch.where(known, scaled, torch.zeros_like(scaled))
