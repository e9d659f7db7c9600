"""Filling of holes by pull-push: pyramids of weighted means. Source: Gortler et al., "The Lumigraph", 1996."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

UNKNOWN = 0.5
"""Value of images without any known pixel."""


def fill(values: Tensor, known: Tensor) -> Tensor:
    """Return images whose unknown pixels are filled from known ones.

    Parameters
    ----------
    values : Tensor
        ``[N, C, H, W]``.
    known : Tensor
        ``[N, 1, H, W]``, 0 or 1.
    """
    levels = [(values * known, known)]
    while max(levels[-1][0].shape[2:]) > 1:
        values, weights = levels[-1]  # values are multiplied by their weights
        height, width = values.shape[2:]
        pad = (0, width % 2, 0, height % 2)
        total = 4 * F.avg_pool2d(F.pad(weights, pad), 2)
        sums = 4 * F.avg_pool2d(F.pad(values, pad), 2)
        kept = total.clamp(max=1)
        levels.append((sums / total.clamp(min=1e-12) * kept, kept))
    filled = torch.full_like(levels[-1][0], UNKNOWN)
    first = True
    for values, weights in reversed(levels):
        if not first:
            height, width = values.shape[2:]
            filled = F.interpolate(filled, scale_factor=2, mode="bilinear", align_corners=False)[:, :, :height, :width]
        first = False
        filled = values + (1 - weights) * filled
    return filled
