"""Batches of training clips, with cameras in the order of the network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..._rig import CameraNumbers, Rig
from ..config import Config
from ..ids import added_time_ids
from ..vae import LATENT_SCALE
from .step import Batch

if TYPE_CHECKING:
    from ....train.clip import Clip

__all__ = ["clip_name", "collate", "rig_of"]

_BINS = 256
"""Depth bins of a recipe that does not say."""


def collate(clips: Sequence[Clip], config: Config, camera_numbers: CameraNumbers) -> Batch:
    """Join clips.

    Raises ``ValueError``, which names the clip, for one frame, for sizes that the network does not take, and for
    clips of other shapes, cameras or depth bins than the first one.
    """
    first = clips[0]
    texts = {"": 0}
    captions = []
    for clip in clips:
        _expect_fit(clip, first, config)
        order = rig_of(clip).order
        captions.append([[texts.setdefault(frame[view], len(texts)) for view in order] for frame in clip.captions])

    def joined(name: str) -> Tensor:
        return torch.stack([getattr(clip, name)[:, rig_of(clip).order] for clip in clips])

    return Batch(
        images=joined("images"),
        boxes=joined("boxes"),
        map=joined("map"),
        color=joined("color"),
        depth_bins=joined("bins"),
        bin_count=_bin_count(first),
        ids=torch.stack([_ids(clip, camera_numbers) for clip in clips]),
        mask=torch.stack([rig_of(clip).mask for clip in clips]),
        texts=tuple(texts),
        caption=torch.tensor(captions),
    )


def rig_of(clip: Clip) -> Rig:
    """Return the cameras of a clip."""
    sizes = tuple((int(width), int(height)) for height, width in clip.original_sizes.tolist())
    return Rig(clip.names, sizes, clip.hz)


def clip_name(clip: Clip) -> str:
    """Return the log and the first frame as a text."""
    return f"log {clip.log}, frame {clip.frame}"


def _ids(clip: Clip, camera_numbers: CameraNumbers) -> Tensor:
    """``added_time_ids`` of a clip, ``float32 [T, V, 13]``, in the order of the network."""
    rig = rig_of(clip)
    cameras = clip.cameras[:, rig.order].double()
    sizes = torch.tensor(rig.image_sizes, dtype=torch.float64)[rig.order]
    width, height = sizes.unbind(-1)
    intrinsics = torch.zeros(*cameras.shape[:2], 3, 3, dtype=torch.float64)
    intrinsics[..., 0, 0], intrinsics[..., 1, 1] = cameras[..., 12] * width, cameras[..., 13] * height
    intrinsics[..., 0, 2], intrinsics[..., 1, 2] = cameras[..., 14] * width, cameras[..., 15] * height
    ego_from_camera = torch.eye(4, dtype=torch.float64).repeat(*cameras.shape[:2], 1, 1)
    ego_from_camera[..., :3, :] = cameras[..., :12].view(*cameras.shape[:2], 3, 4)
    return added_time_ids(
        intrinsics[None],
        sizes.expand(1, *cameras.shape[:2], 2),
        ego_from_camera[None],
        clip.global_from_ego[None, :, None],
        clip.hz,
        camera_numbers=camera_numbers,
    )[0]


def _bin_count(clip: Clip) -> int:
    count = clip.recipe.get("bins", {}).get("count", _BINS)
    if type(count) is not int or count < 2:
        raise ValueError(f"expected bins.count of 2 or more in the recipe, found {count!r}: {clip_name(clip)}")
    return count


def _expect_fit(clip: Clip, first: Clip, config: Config) -> None:
    name = clip_name(clip)
    frames, views, _, height, width = clip.images.shape
    if frames < 2:
        raise ValueError(f"expected clips of at least 2 frames, for the motion of the ego, found 1: {name}")
    unit = LATENT_SCALE * config.patch_size
    if height % unit or width % unit:
        raise ValueError(f"expected height and width in multiples of {unit}, found {height}x{width}: {name}")
    if int(clip.bins.max()) > _bin_count(clip):
        raise ValueError(f"expected depth bins of at most {_bin_count(clip)}, found {int(clip.bins.max())}: {name}")
    for what, expected, found in (
        ("images", list(first.images.shape), list(clip.images.shape)),
        ("cameras", sorted(first.names), sorted(clip.names)),
        ("depth bins", _bin_count(first), _bin_count(clip)),
    ):
        if expected != found:
            raise ValueError(f"expected {what} {expected} as in the first clip of the batch, found {found}: {name}")
