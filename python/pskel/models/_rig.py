"""Cameras of a log, and their order in the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

__all__ = ["CAMERA_NUMBERS", "PUBLISHED", "CameraNumbers", "Published", "Rig", "inverse", "ring_mask"]

CameraNumbers = Literal["fx,fy,cx,cy", "fx,0,cx,fy"]
"""Intrinsics that the video network gets: fx/H, fy/H, cx/W, cy/H; or fx/H, 0, cx/W, fy/H.

The published nuPlan weights were trained with the second: their reader pads intrinsics to 4x4 matrices, but takes the
elements 0, 4, 2, 5 of a 3x3 matrix.
"""
CAMERA_NUMBERS: tuple[CameraNumbers, ...] = ("fx,fy,cx,cy", "fx,0,cx,fy")


class Published(NamedTuple):
    """Inputs that a published checkpoint was trained with."""

    name: str
    cameras: tuple[str, ...]
    """In the order of the training."""
    frames: int
    fps: float
    size: tuple[int, int]
    """Height and width."""
    camera_numbers: CameraNumbers


PUBLISHED = (
    Published(
        "nuScenes",
        ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT"),
        frames=12,
        fps=6.0,
        size=(256, 448),
        camera_numbers="fx,fy,cx,cy",
    ),
    Published(
        "nuPlan",
        ("CAM_L1", "CAM_L0", "CAM_F0", "CAM_R0", "CAM_R1", "CAM_R2", "CAM_B0", "CAM_L2"),
        frames=10,
        fps=5.0,
        size=(224, 448),
        camera_numbers="fx,0,cx,fy",
    ),
)
"""In both orders, neighbors in the list, and its ends, are neighbors on the vehicle."""


@dataclass(frozen=True)
class Rig:
    """Cameras of a log in the order of all arrays, sizes of their original images, and the rate of frames.

    Raises ``ValueError`` for names that repeat, for other than one size (width, height) per camera, and for sizes or a rate
    that are not positive.
    """

    cameras: tuple[str, ...]
    image_sizes: tuple[tuple[int, int], ...]
    fps: float

    def __post_init__(self) -> None:
        if not self.cameras or len(set(self.cameras)) != len(self.cameras):
            raise ValueError(f"expected cameras with different names, found {', '.join(self.cameras) or 'none'}")
        if len(self.image_sizes) != len(self.cameras):
            raise ValueError(f"expected image sizes of {len(self.cameras)} cameras, found {len(self.image_sizes)}")
        if wrong := [size for size in self.image_sizes if len(size) != 2 or min(size) < 1]:
            raise ValueError(f"expected image sizes of width and height in pixels, found {list(wrong[0])}")
        if not 0.0 < self.fps < float("inf"):
            raise ValueError(f"expected a positive number of frames per second, found {self.fps}")

    @property
    def published(self) -> Published | None:
        """The published checkpoint of these cameras, or ``None``."""
        return next((known for known in PUBLISHED if set(known.cameras) == set(self.cameras)), None)

    @property
    def order(self) -> list[int]:
        """Camera indices in the network's order: as trained, or as given for an unknown rig."""
        known = self.published
        return list(range(len(self.cameras))) if known is None else [self.cameras.index(name) for name in known.cameras]

    @property
    def camera_numbers(self) -> CameraNumbers:
        """Intrinsics that the published checkpoint of these cameras was trained with; all four for an unknown rig."""
        known = self.published
        return "fx,fy,cx,cy" if known is None else known.camera_numbers

    @property
    def mask(self) -> Tensor:
        """``bool [V, V]`` in the order of the network: a camera sees itself and its neighbors in the ring."""
        return ring_mask(len(self.cameras))


def ring_mask(views: int) -> Tensor:
    """Return ``bool [V, V]``, true for a camera and its neighbors in a ring."""
    index = torch.arange(views)
    distance = (index[:, None] - index).abs()
    return torch.minimum(distance, views - distance) <= 1


def inverse(order: Sequence[int]) -> list[int]:
    """Return the permutation that undoes ``order``."""
    return [order.index(i) for i in range(len(order))]
