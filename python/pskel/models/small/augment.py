"""Random changes of training windows: appearance, exposure, missing points, reflection, errors of latents."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Generator, Tensor

from .inputs import Maps

BLOCK = 32
"""Side of the blocks of pixels that lose their points, or whose mean colors become those in the images."""


class Dice:
    """Random numbers of a generator."""

    def __init__(self, generator: Generator) -> None:
        self.generator = generator

    def unit(self) -> float:
        """Return a number from 0 to 1."""
        return float(torch.rand((), generator=self.generator))

    def between(self, low: float, high: float) -> float:
        """Return a number between two numbers."""
        return low + (high - low) * self.unit()

    def below(self, count: int) -> int:
        """Return a whole number from 0 to below ``count``."""
        return int(torch.randint(count, (), generator=self.generator))

    def normal(self, like: Tensor) -> Tensor:
        """Return normal numbers in the shape of a tensor."""
        return torch.randn(like.shape, generator=self.generator).to(like)

    def uniform(self, *shape: int) -> Tensor:
        """Return numbers from 0 to 1."""
        return torch.rand(shape, generator=self.generator)


def augmented(maps: Maps, images: Tensor, action: Tensor, views: int, share: float, dice: Dice) -> tuple[Maps, Tensor, Tensor]:
    """Change a window of ``[L V, ..]`` maps and images and its ego motion ``[L, 3]``; each change has a chance of ``share``."""
    changed, exposed, thinned, cut, covered, mirrored = (dice.unit() < of * share for of in (1.0, 1.0, 0.8, 0.4, 0.4, 0.5))
    known = maps.known()[0]
    color = maps.color
    if changed:
        gain = dice.between(-0.3, 0.3)
        gamma, offset, saturation = 2.718281828 ** dice.between(-0.4, 0.4), dice.between(-0.08, 0.08), dice.between(0.4, 1.5)
        gains = torch.tensor([gain + dice.between(-0.12, 0.12) for _ in range(3)]).exp()[:, None, None].to(color)

        def appearance(levels: Tensor) -> Tensor:
            levels = levels**gamma
            gray = levels.mean(1, keepdim=True)
            return ((gray + (levels - gray) * saturation) * gains + offset).clamp(0, 1)

        images, color = appearance(images), appearance(color)
    if exposed:
        exposures = torch.exp((dice.uniform(views) * 2 - 1) * 0.05).to(color)
        color = (color * exposures.repeat(len(color) // views)[:, None, None, None]).clamp(0, 1)
    kept = torch.ones_like(known)
    height, width = color.shape[2:]
    if thinned:
        kept = kept * (dice.uniform(len(color), 1, height, width) >= dice.between(0, 0.7)).to(kept)
    if covered:
        blocks = dice.uniform(len(color), 1, -(-height // BLOCK), -(-width // BLOCK)) >= dice.between(0, 0.4)
        kept = kept * F.interpolate(blocks.to(kept), scale_factor=BLOCK)[:, :, :height, :width]
    if cut:
        kept[:, :, : int(dice.between(0, 0.5) * height)] = 0
    # A known color is not black, which would mean that it is not known.
    color = color.clamp(min=1 / 255) * known * kept
    depth = torch.where(kept > 0, maps.depth, torch.full_like(maps.depth, -1))
    maps = maps._replace(color=color, depth=depth)
    if not mirrored:
        return maps, images, action
    flip = [_mirrored(each, views) for each in (*maps[:4], images)]
    cameras = maps.cameras.reshape(-1, views, 16).flip(1).reshape(-1, 16).clone()
    # The ego's y axis and the camera's x axis change their directions.
    signs = torch.tensor([-1.0 if (i // 4 == 1) != (i % 4 == 0) else 1.0 for i in range(12)] + [1.0] * 4).to(cameras)
    cameras = cameras * signs
    cameras[:, 14] = 1 - cameras[:, 14]
    known_action = (action != -1000).all(-1, keepdim=True)
    turned = torch.where(known_action, action * action.new_tensor([1.0, -1.0, -1.0]), action)
    color, depth, boxes, map, images = flip
    return Maps(color, depth, boxes, map, cameras), images, turned


def agreeing(maps: Maps, images: Tensor) -> Maps:
    """Return maps whose known colors have the means of the images in blocks of 32x32 pixels, about.

    A network that sees such windows does not learn how points and images of these logs differ, as by reflections and exposure.
    """
    known = maps.known()[0]
    count = F.avg_pool2d(known, BLOCK)
    means = F.avg_pool2d((images - maps.color) * known, BLOCK) / count.clamp(min=1e-6)
    off = F.interpolate(means, scale_factor=BLOCK, mode="bilinear", align_corners=False)
    return maps._replace(color=(maps.color + off).clamp(1 / 255, 1) * known)


def _mirrored(images: Tensor, views: int) -> Tensor:
    return images.flip(-1).reshape(-1, views, *images.shape[1:]).flip(1).reshape(images.shape)


def erring(clean: Tensor, dice: Dice) -> Tensor:
    """Return latents ``[L, V, C, h, w]`` with errors as in generated frames: another brightness of images, and noise."""
    frames, views, channels = clean.shape[:3]
    gain = torch.exp((dice.uniform(frames, views, 1, 1, 1) * 2 - 1) * 0.2)
    shift = (dice.uniform(frames, views, 1, 1, 1) * 2 - 1) * 0.3 + (dice.uniform(frames, views, channels, 1, 1) * 2 - 1) * 0.1
    spread = dice.unit() * 0.3
    return clean * gain.to(clean) + shift.to(clean) + spread * dice.normal(clean)
