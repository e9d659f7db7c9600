"""Conditions as the network takes them, from training clips and from the denoiser protocol."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from .._condition import POINT_CHANNELS as MAP_CHANNELS
from .._rig import Rig, inverse, ring_mask
from ..pas.ids import ids_from_motion
from ..pas.training.collate import clip_name, rig_of
from ..pas.training.depth import depth_channels
from .config import LATENT_SCALE, Config
from .network import POINT_CHANNELS

if TYPE_CHECKING:
    from ...train.clip import Clip

__all__ = ["Batch", "collate", "expect_size", "point_channels", "visible"]


class Batch(NamedTuple):
    """B clips of T frames and V cameras."""

    images: Tensor
    """``uint8 [B, T, V, 3, H, W]``."""
    boxes: Tensor
    map: Tensor
    color: Tensor
    """``uint8 [B, T, V, 3, H, W]`` each; color is black where empty."""
    bins: Tensor
    """Depth, ``int16 [B, T, V, H, W]``: 0 where empty, else 1 to ``bin_count``."""
    bin_count: int
    ids: Tensor
    """Camera and motion numbers, ``float32 [B, T, V, 13]``."""
    mask: Tensor
    """Cameras that see each other, ``bool [B, V, V]``."""
    texts: tuple[str, ...]
    """Different captions, of which the first is empty."""
    caption: Tensor
    """Number of the text of each image, ``int64 [B, T, V]``."""

    def to(self, device: torch.device | str) -> Batch:
        """Copy to a device."""
        values: list[Any] = [value.to(device) if isinstance(value, Tensor) else value for value in self]
        return Batch(*values)


def collate(clips: Sequence[Clip], config: Config) -> Batch:
    """Join clips.

    Raises ``ValueError``, which names the clip, for one frame, for sizes that are not multiples of 8, for other depth
    bins than in ``config``, and for clips of other shapes or bins than the first one.
    """
    first = clips[0]
    count = _bin_count(first)
    texts = {"": 0}
    for clip in clips:
        _expect_same(clip, first, count, config)
        for frame in clip.captions:
            for text in frame:
                texts.setdefault(text, len(texts))
    return Batch(
        images=torch.stack([clip.images for clip in clips]),
        boxes=torch.stack([clip.boxes for clip in clips]),
        map=torch.stack([clip.map for clip in clips]),
        color=torch.stack([clip.color for clip in clips]),
        bins=torch.stack([clip.bins for clip in clips]),
        bin_count=count,
        ids=torch.stack([_ids(clip) for clip in clips]),
        mask=torch.stack([visible(rig_of(clip)) for clip in clips]),
        texts=tuple(texts),
        caption=torch.tensor([[[texts[text] for text in frame] for frame in clip.captions] for clip in clips]),
    )


def visible(rig: Rig) -> Tensor:
    """Return ``bool [V, V]`` in the order of the rig: a camera sees itself and its neighbors in the ring."""
    places = inverse(rig.order)
    return ring_mask(len(places))[places][:, places]


def point_channels(points: Tensor, config: Config) -> Tensor:
    """Return the point conditions ``[.., 20, H, W]`` of color and depth ``[.., 4, H, W]``, -1 in depth where empty."""
    if config.depth == "both":
        color, depth = points[..., :3, :, :], points[..., 3, :, :]
        bins = torch.where(depth < 0, 0.0, (depth * (config.depth_bins - 1)).round())
        return torch.cat([color, depth_channels(bins, config.depth_bins, "both")], dim=-3)
    waves = points.new_zeros((*points.shape[:-3], POINT_CHANNELS - MAP_CHANNELS, *points.shape[-2:]))
    return torch.cat([points, waves], dim=-3)


def expect_size(size: Sequence[int]) -> None:
    """Raise ``ValueError`` for a size (height, width) of which the latents are not whole."""
    height, width = size
    if min(size) < LATENT_SCALE or height % LATENT_SCALE or width % LATENT_SCALE:
        raise ValueError(f"expected height and width in multiples of {LATENT_SCALE}, found {height}x{width}")


def _ids(clip: Clip) -> Tensor:
    return ids_from_motion(clip.cameras, clip.original_sizes.flip(-1), clip.action, clip.hz)


def _bin_count(clip: Clip) -> int:
    bins = clip.recipe.get("bins", {})
    count = bins.get("count", Config().depth_bins)  # the default of a recipe
    if type(count) is not int:
        raise ValueError(f"expected bins.count as a whole number in the recipe of {clip_name(clip)}, found {count!r}")
    return count


def _expect_same(clip: Clip, first: Clip, count: int, config: Config) -> None:
    name, found = clip_name(clip), _bin_count(clip)
    if len(clip.images) < 2:
        raise ValueError(f"expected clips of at least 2 frames, found 1: {name}")
    try:
        expect_size(clip.images.shape[-2:])
    except ValueError as error:
        raise ValueError(f"{error}: {name}") from None
    if config.depth == "both" and found != config.depth_bins:
        raise ValueError(f"expected {config.depth_bins} depth bins, found {found}: {name}")
    if found != count:
        raise ValueError(f"expected {count} depth bins as in the first clip of the batch, found {found}: {name}")
    if clip.images.shape != first.images.shape:
        expected, shape = list(first.images.shape), list(clip.images.shape)
        raise ValueError(f"expected images of {expected} as in the first clip of the batch, found {shape}: {name}")
