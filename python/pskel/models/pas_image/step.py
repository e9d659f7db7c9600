"""The training step: network inputs and loss of a batch, as a function of explicit draws.

In a share of the clips the frames before the last are as in a rollout: slightly noisy, and without loss (*Point as
Skeleton*). In the others every frame has a level of its own (diffusion forcing, arXiv:2407.01392), as in a roll.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor

from .._condition import DROPPED_MOTION, NO_COLOR
from ..pas.ids import MOTION_IDS
from ..pas.training.depth import depth_channels
from .conditions import Batch
from .config import Config
from .network import Inputs
from .schedule import TIMESTEPS, Schedule

__all__ = [
    "DROPPABLE",
    "Draws",
    "StepOptions",
    "Targets",
    "conditioned",
    "errors_of",
    "levels_of",
    "loss_of",
    "noisy_inputs",
]

DROPPABLE = ("text", "boxes", "map", "action", "depth", "color", "single_frames")
"""Parts of the conditions that a clip may be without; the last is attention across frames."""


@dataclass(frozen=True)
class StepOptions:
    """Probabilities and levels. Raises ``ValueError`` for a probability that is not 0 to 1, and for other levels."""

    previous_share: float = 0.5
    """Share of clips whose frames before the last are nearly clean, and without loss."""
    previous_from: int = 50
    previous_to: int = 200
    """First and last level of these frames."""
    drop_text: float = 0.2
    drop_boxes: float = 0.2
    drop_map: float = 0.2
    drop_action: float = 0.2
    drop_depth: float = 0.1
    drop_color: float = 0.1
    single_frames: float = 0.1
    """Share of clips without attention across frames."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(field.default, float) and not 0.0 <= value <= 1.0:
                raise ValueError(f"expected {field.name} of 0 to 1, found {value}")
        if not 0 <= self.previous_from <= self.previous_to < TIMESTEPS:
            found = f"{self.previous_from} and {self.previous_to}"
            raise ValueError(f"expected previous_from of at most previous_to, from 0 to {TIMESTEPS - 1}, found {found}")

    def chance(self, part: str) -> float:
        """Return the probability that a clip is without a part of ``DROPPABLE``."""
        chance: float = self.single_frames if part == "single_frames" else getattr(self, f"drop_{part}")
        return chance


class Draws(NamedTuple):
    """All random numbers of a step over B clips with T frames: the first two normal, the others uniform from 0 to 1."""

    posterior_noise: Tensor
    """Of the autoencoder's posterior, ``[B, T, V, C, h, w]``."""
    noise: Tensor
    """Of the diffusion, ``[B, T, V, C, h, w]``."""
    level: Tensor
    """``[B, T]``."""
    previous: Tensor
    """Of the choice of clips with nearly clean frames, ``[B]``."""
    text: Tensor
    """Of the dropout of a condition, ``[B]``; likewise the next five."""
    boxes: Tensor
    map: Tensor
    action: Tensor
    depth: Tensor
    color: Tensor
    single_frames: Tensor
    """Of the choice of clips without attention across frames, ``[B]``."""

    @classmethod
    def sample(cls, generator: torch.Generator, clips: int, latents: Sequence[int]) -> Draws:
        """Draw the numbers of ``clips`` clips, whose latents have the shape ``latents``, ``[T, V, C, h, w]``."""

        def normal() -> Tensor:
            return torch.randn(clips, *latents, generator=generator)

        def uniform(*shape: int) -> Tensor:
            return torch.rand(clips, *shape, generator=generator)

        return cls(
            posterior_noise=normal(),
            noise=normal(),
            level=uniform(latents[0]),
            previous=uniform(),
            text=uniform(),
            boxes=uniform(),
            map=uniform(),
            action=uniform(),
            depth=uniform(),
            color=uniform(),
            single_frames=uniform(),
        )

    def to(self, device: torch.device | str) -> Draws:
        """Copy to a device."""
        return Draws(*(tensor.to(device) for tensor in self))


class Targets(NamedTuple):
    """Values that the loss compares."""

    output: Tensor
    """Noise, or velocity, ``float32 [B, T, V, C, h, w]``."""
    is_counted: Tensor
    """Frames in the loss, ``bool [B, T]``."""


def levels_of(draws: Draws, options: StepOptions) -> tuple[Tensor, Tensor]:
    """Return the timestep of each frame, ``int64 [B, T]``, and whether it is in the loss, ``bool [B, T]``."""
    free = _whole(draws.level, 0, TIMESTEPS - 1)
    nearly_clean = _whole(draws.level, options.previous_from, options.previous_to)
    is_previous = (draws.previous < options.previous_share).unsqueeze(-1).expand(free.shape).clone()
    is_previous[:, -1] = False
    return torch.where(is_previous, nearly_clean, free), ~is_previous


def conditioned(
    batch: Batch, text: Tensor, sample: Tensor, timestep: Tensor, dropped: Mapping[str, Tensor], config: Config
) -> Inputs:
    """Return the network's inputs for latents ``sample`` ``[B, T, V, C, h, w]`` at levels ``timestep`` ``[B, T]``.

    ``text`` are the tokens of the batch's texts, ``[N, S, D]``. ``dropped`` are, ``bool [B]`` each, the clips without
    each of ``DROPPABLE``.
    """
    caption = torch.where(_per_clip(dropped["text"], 3), 0, batch.caption)
    bins = torch.where(_per_clip(dropped["depth"], 5), 0, batch.bins)
    points = [_map(batch.color, dropped["color"]), depth_channels(bins, batch.bin_count, config.depth)]
    layout = [_map(batch.boxes, dropped["boxes"]), _map(batch.map, dropped["map"])]
    return Inputs(
        sample=sample,
        timestep=timestep.float(),
        text=text[caption],
        layout=torch.cat(layout, dim=3),
        points=torch.cat(points, dim=3),
        ids=_ids(batch.ids, dropped["action"]),
        mask=batch.mask,
        single_frames=dropped["single_frames"],
    )


def noisy_inputs(
    batch: Batch,
    text: Tensor,
    latents: Tensor,
    draws: Draws,
    schedule: Schedule,
    config: Config,
    options: StepOptions = StepOptions(),
) -> tuple[Inputs, Targets]:
    """Add noise to latents ``float32 [B, T, V, C, h, w]``, and drop conditions; see ``conditioned``."""
    timesteps, is_counted = levels_of(draws, options)
    dropped = {part: getattr(draws, part) < options.chance(part) for part in DROPPABLE}
    inputs = conditioned(batch, text, schedule.noisy(latents, draws.noise, timesteps), timesteps, dropped, config)
    return inputs, Targets(schedule.target(config.prediction, latents, draws.noise, timesteps), is_counted)


def errors_of(output: Tensor, targets: Targets) -> Tensor:
    """Return the mean square error of each frame, ``float32 [B, T]``, of an output ``[B, T, V, C, h, w]``."""
    return (output.float() - targets.output).square().mean(dim=(2, 3, 4, 5))


def loss_of(errors: Tensor, targets: Targets) -> Tensor:
    """Return the mean of ``errors_of`` over the frames that count."""
    counted = targets.is_counted.to(errors)
    return (errors * counted).sum() / counted.sum()


def _whole(uniform: Tensor, first: int, last: int) -> Tensor:
    """Whole numbers ``first`` to ``last`` of uniform numbers."""
    count = last - first + 1
    return first + (uniform * count).floor().long().clamp(max=count - 1)


def _map(image: Tensor, is_dropped: Tensor) -> Tensor:
    """Convert an image ``uint8 [B, T, V, 3, H, W]`` to values of 0 to 1, or to the value of a dropped one."""
    return torch.where(_per_clip(is_dropped, 6), NO_COLOR, image.float() / 255.0)


def _ids(ids: Tensor, is_dropped: Tensor) -> Tensor:
    """Drop speed and steering."""
    motion = torch.where(_per_clip(is_dropped, 4), DROPPED_MOTION, ids[..., -MOTION_IDS:])
    return torch.cat([ids[..., :-MOTION_IDS], motion], dim=-1)


def _per_clip(values: Tensor, dimensions: int) -> Tensor:
    """Expand ``[B]`` to be broadcast to so many dimensions."""
    return values.view(-1, *[1] * (dimensions - 1))
