"""Depth channels of the point conditions (docs/src/reference/maps.md, model tensors)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import torch
from torch import Tensor

from ..._condition import NO_DEPTH

__all__ = ["DEPTH_MODES", "DepthMode", "depth_channels"]

DepthMode = Literal["continuous", "both"]
"""``continuous``: depth alone, sines and cosines are 0. ``both``: all channels."""
DEPTH_MODES: tuple[DepthMode, ...] = ("continuous", "both")

_FREQUENCIES = 8


def depth_channels(bins: Tensor, count: int, mode: DepthMode) -> Tensor:
    """Return depth, its sines (8) and cosines (8), ``float32 [.., 17, H, W]``, of depth bins.

    ``bins`` ``[.., H, W]`` are 0 where empty, else 1 to ``count``. Empty pixels are -1 in depth, else 0.
    """
    if mode not in DEPTH_MODES:
        raise ValueError(f"expected depth of {' or '.join(DEPTH_MODES)}, found {mode}")
    table = _table(count).to(bins.device)
    if mode == "continuous":
        depth = table[:, 0][bins.long()].unsqueeze(-3)
        waves = depth.new_zeros((*bins.shape[:-2], 2 * _FREQUENCIES, *bins.shape[-2:]))
        return torch.cat([depth, waves], dim=-3)
    return table[bins.long()].movedim(-1, -3)


@lru_cache(maxsize=4)
def _table(count: int) -> Tensor:
    """Values of all channels for each bin, ``float32 [count + 1, 17]``; in the renderer's order of operations."""
    unit = torch.arange(1, count + 1).clamp(max=count - 1).float() / (count - 1)
    octaves = math.log2(count / 2)
    frequencies = torch.tensor([2.0 ** (k * octaves / (_FREQUENCIES - 1)) for k in range(_FREQUENCIES)])
    phase = ((torch.tensor(2.0 * math.pi) * unit)[:, None] * frequencies).double()
    filled = torch.cat([unit[:, None], phase.sin().float(), phase.cos().float()], dim=1)
    empty = torch.zeros(1, filled.shape[1])
    empty[0, 0] = NO_DEPTH
    return torch.cat([empty, filled])
