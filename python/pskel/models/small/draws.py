"""Batches of the training: augmented windows with noise, and crops of images to decode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .augment import Dice, agreeing, augmented, erring
from .config import CELL, TOKEN
from .inputs import NO_ACTION, NO_COLOR, Maps, cells, ego_numbers, full_planes, token_rays, work_planes
from .levels import SIGMA_MIN
from .network import Window

__all__ = ["Batch", "DrawOptions", "Frames", "Statistics", "draw_batch", "draw_levels"]


@dataclass(frozen=True)
class DrawOptions:
    """What is drawn at random."""

    drop_layout: float = 0.1
    drop_action: float = 0.1
    drop_color: float = 0.15
    drop_depth: float = 0.15
    drop_all: float = 0.04
    """Chances of dropping conditions of a window, independent of each other."""
    infer_steps: int = 8
    shift: float = 3.0
    staircase: float = 0.5
    """Share of windows with the noise levels of a roll, after some finished frames; others have independent levels."""
    history: float = 0.5
    """Share of the other windows that begin with some finished frames."""
    augment: float = 0.9
    """Share of windows whose colors, exposures, points and sides are changed."""
    agreement: float = 0.0
    """Share of windows whose points have the mean colors of the images, for networks that are used on other data sets."""
    errors: float = 0.8
    """Share of windows whose frames have errors like generated ones, so that the network does not trust earlier frames more than
    conditions."""
    all_cameras: float = 0.4
    """Share of batches with all cameras in a window; the others have some neighbors."""
    crop: tuple[int, int] = (128, 224)
    """Height and width of the crops that are decoded."""
    crops: int = 1
    """Crops of each decoded image."""


class Frames(NamedTuple):
    """Frames of some cameras: maps and images ``[L V, ..]``, ego motion ``[L, 3]``."""

    maps: Maps
    images: Tensor
    action: Tensor


class Statistics(NamedTuple):
    """Means and standard deviations of mean colors of 16x16 pixels, and the expected error of the denoiser; each ``[3]``."""

    means: Tensor
    scales: Tensor
    priors: Tensor

    def latents(self, colors: Tensor) -> Tensor:
        """Return latents of mean colors ``[..., 3, h, w]``."""
        return (colors - self.means[:, None, None]) / self.scales[:, None, None]


class Batch(NamedTuple):
    """B windows of L frames and V cameras, and K crops of their images."""

    window: Window
    clean: Tensor
    """Latents of the images, ``[B, L, V, 3, h, w]``."""
    guess: Tensor
    """Latents of the filled color."""
    noise: Tensor
    """The noise that leads from the clean latents to the noisy ones."""
    counts: Tensor
    """Whether a frame counts in the loss, ``[B, L]``; finished ones do not."""
    planes: Tensor
    """Conditions of the crops, ``[K, 16, H, W]``."""
    truth: Tensor
    """Images of the crops, 0 to 1, ``[K, 3, H, W]``."""
    places: Tensor
    """Image of ``[B L V]``, top and left of each crop, ``int64 [K, 3]``, in 16x16 pixels."""


def sigmas_of(steps: int, shift: float) -> Tensor:
    """Return the noise levels of inference steps, as diffusers' ``FlowMatchEulerDiscreteScheduler``."""

    def shifted(sigma: Tensor) -> Tensor:
        return shift * sigma / (1 + (shift - 1) * sigma)

    one = torch.ones((), dtype=torch.float64)
    return shifted(torch.lerp(one, shifted(one / 1000), torch.linspace(0, 1, steps, dtype=torch.float64))).float()


def draw_levels(options: DrawOptions, frames: int, dice: Dice) -> tuple[int, Tensor]:
    """Return the number of finished frames, and the noise level of each frame, ``[L]``."""
    table = sigmas_of(options.infer_steps, options.shift)
    if dice.unit() < options.staircase:
        per_roll = options.infer_steps // frames
        call = options.infer_steps - per_roll + dice.below(per_roll)
        finished = dice.below(frames)
        places = [call - max(0, frame - finished) * per_roll for frame in range(frames)]
        levels = [table[-1] if frame < finished else table[place] for frame, place in enumerate(places)]
        return finished, torch.stack(levels)
    finished = dice.below(frames) if dice.unit() < options.history else 0
    time = dice.uniform(frames)
    levels_at = (options.shift * time / (1 + (options.shift - 1) * time)).clamp(min=SIGMA_MIN)
    levels_at[:finished] = table[-1]
    return finished, levels_at


def _dropped(frames: Frames, options: DrawOptions, dice: Dice) -> Frames:
    """Drop conditions at random, for all frames and cameras alike."""
    everything = dice.unit() < options.drop_all
    layout, action, color, depth = (
        dice.unit() < chance or everything
        for chance in (options.drop_layout, options.drop_action, options.drop_color, options.drop_depth)
    )
    maps = frames.maps
    if layout:
        maps = maps._replace(boxes=torch.full_like(maps.boxes, NO_COLOR), map=torch.full_like(maps.map, NO_COLOR))
    if color:
        maps = maps._replace(color=torch.full_like(maps.color, NO_COLOR))
    if depth:
        maps = maps._replace(depth=torch.full_like(maps.depth, -1))
    return frames._replace(maps=maps, action=torch.full_like(frames.action, NO_ACTION) if action else frames.action)


def draw_batch(windows: Sequence[Frames], statistics: Statistics, options: DrawOptions, dice: Dice) -> Batch:
    """Return a batch of windows that have the same number of frames and cameras."""
    rows, crops = [], []
    for number, window in enumerate(windows):
        length = len(window.action)
        views = len(window.images) // length
        if options.agreement > 0 and dice.unit() < options.agreement:
            window = window._replace(maps=agreeing(window.maps, window.images))
        maps, images, action = augmented(*window, views, options.augment, dice)
        maps, _, action = _dropped(Frames(maps, images, action), options, dice)
        finished, sigmas = draw_levels(options, length, dice)
        height, width = images.shape[2:]
        work = work_planes(maps)
        shape = (length, views, -1, height // CELL, width // CELL)
        clean = statistics.latents(F.avg_pool2d(images, CELL)).reshape(shape)
        guess = statistics.latents(cells(work)).reshape(shape)
        counts = torch.arange(length) >= finished
        wrong = erring(clean, dice) if dice.unit() < options.errors else clean
        noise, noisy = _noisy(clean, wrong, sigmas, counts, dice)
        rays = token_rays(maps.cameras, height, width).reshape(length, views, height // TOKEN, width // TOKEN, -1)
        rows.append((work, noisy, sigmas, rays, ego_numbers(action), clean, guess, noise, counts))
        # The frames with the most noise and with the least, of those that are not finished.
        frames = sorted({finished + int(sigmas[finished:].argmax()), finished + int(sigmas[finished:].argmin())})
        chosen = [frame * views + view for frame in frames for view in range(views)]
        planes = full_planes(Maps(*(each[chosen] for each in maps)))
        for place, image in enumerate(chosen):
            for _ in range(options.crops):
                top, left = (TOKEN * dice.below((side - crop) // TOKEN + 1) for side, crop in zip((height, width), options.crop))
                cut = (slice(None), slice(top, top + options.crop[0]), slice(left, left + options.crop[1]))
                at = torch.tensor([number * length * views + image, top // CELL, left // CELL])
                crops.append((planes[place][cut], images[image][cut], at))
    works, *others = zip(*rows)
    noisy, sigmas, rays, ego, clean, guess, noise, counts = (torch.stack(each) for each in others)
    planes, truth, places = (torch.stack(each) for each in zip(*crops))
    drawn = Window(torch.cat(works), noisy, sigmas, rays, ego)
    return Batch(drawn, clean, guess, noise, counts, planes, truth, places)


def _noisy(clean: Tensor, wrong: Tensor, sigmas: Tensor, counts: Tensor, dice: Dice) -> tuple[Tensor, Tensor]:
    """Return noise and noisy latents of a window ``[L, V, 3, h, w]``.

    Finished frames have errors and no noise. The others have errors too, less so at low levels; the noise is changed to what
    leads from the noisy latents to the clean ones.
    """
    s = sigmas[:, None, None, None, None]
    noise = dice.normal(clean) + (wrong - clean) * (s / 0.3).clamp(max=1) * (1 - s) / s
    noisy = (1 - s) * clean + s * noise
    return noise, torch.where(counts[:, None, None, None, None], noisy, wrong)
