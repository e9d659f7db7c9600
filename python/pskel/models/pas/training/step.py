"""The training step: network inputs and loss of a batch, as a function of explicit draws.

It equals the step of the paper's authors: diffusion forcing (arXiv:2407.01392) with an independent noise level for each
frame, flow matching (arXiv:2403.03206), dropouts of conditions, and errors in the noisy latents. Nothing is drawn here.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor

from ..._condition import DROPPED_MOTION, NO_COLOR
from ..ids import MOTION_IDS
from .depth import DepthMode, depth_channels
from .draws import Draws

__all__ = ["Batch", "Inputs", "StepOptions", "Targets", "loss_of", "noisy_inputs", "sampled_latents", "sigmas_of"]

_LEVELS = 1000
_SHIFT = 3.0


@dataclass(frozen=True)
class StepOptions:
    """Probabilities of the dropouts, and deviations of the errors; the defaults are the authors'.

    Raises ``ValueError`` for a probability that is not between 0 and 1, and for a negative deviation.
    """

    drop_text: float = 0.2
    drop_boxes: float = 0.2
    drop_map: float = 0.2
    drop_action: float = 0.2
    drop_depth: float = 0.1
    drop_color: float = 0.1
    single_frames: float = 0.1
    """Share of clips without attention across frames."""
    input_scale_std: float = 0.01
    input_offset_std: float = 0.01
    """Errors of the noisy latents, of clips with attention across frames."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            most = float("inf") if field.name.endswith("_std") else 1.0
            if not 0.0 <= value <= most:
                raise ValueError(f"expected {field.name} of 0 to {most:g}, found {value}")


class Batch(NamedTuple):
    """B clips of T frames and V cameras in the order of the network."""

    images: Tensor
    """``uint8 [B, T, V, 3, H, W]``."""
    boxes: Tensor
    map: Tensor
    color: Tensor
    """``uint8 [B, T, V, 3, H, W]`` each; color is black where empty."""
    depth_bins: Tensor
    """``int16 [B, T, V, H, W]``, 0 where empty, else 1 to ``bin_count``."""
    bin_count: int
    ids: Tensor
    """``added_time_ids``, ``float32 [B, T, V, 13]``."""
    text: Tensor
    """Tokens of N texts, ``[N, S, D]``; text 0 is empty."""
    pooled: Tensor
    """``[N, P]``."""
    caption: Tensor
    """Number of the text of each image, ``int64 [B, T, V]``."""
    mask: Tensor
    """Cameras that see each other, ``bool [B, V, V]``."""

    def to(self, device: torch.device | str) -> Batch:
        """Copy to a device."""
        return Batch(*(value.to(device) if isinstance(value, Tensor) else value for value in self))


class Inputs:
    """Arguments of the network, see ``Network.forward`` and ``Network.encode_conditions``.

    A class of its own, not a tuple of tensors: FSDP rounds tensors among the arguments to half precision, but timesteps and
    ``ids`` need more digits.
    """

    def __init__(
        self,
        *,
        sample: Tensor,
        timestep: Tensor,
        text: Tensor,
        pooled: Tensor,
        layout: Tensor,
        points: Tensor | None,
        ids: Tensor,
        mask: Tensor,
        single_frames: Tensor,
    ) -> None:
        self.sample = sample
        self.timestep = timestep
        self.text = text
        self.pooled = pooled
        self.layout = layout
        self.points = points
        self.ids = ids
        self.mask = mask
        self.single_frames = single_frames


class Targets(NamedTuple):
    """Values that the loss compares."""

    latents: Tensor
    """Without noise, ``float32 [B, T, V, C, h, w]``."""
    sample: Tensor
    """Input of the network, of this shape."""
    sigma: Tensor
    """Noise level of each frame, ``[B, T]``."""


def sampled_latents(mean: Tensor, std: Tensor, noise: Tensor, shift: float, scale: float) -> Tensor:
    """Sample the posterior of the autoencoder, of one shape; returns ``(z - shift) * scale``."""
    return (mean + std * noise - shift) * scale


def sigmas_of(level: Tensor) -> Tensor:
    """Return the noise levels of normal numbers, of any shape: logit-normal, on the table of 1000 steps with shift 3."""
    index = (level.sigmoid() * _LEVELS).floor().clamp(max=_LEVELS - 1)
    steps = torch.arange(_LEVELS, 0, -1, dtype=torch.float32, device=level.device) / _LEVELS
    table = _SHIFT * steps / (1.0 + (_SHIFT - 1.0) * steps)
    return table[index.long()]


def noisy_inputs(
    batch: Batch,
    latents: Tensor,
    draws: Draws,
    options: StepOptions = StepOptions(),
    *,
    depth: DepthMode = "continuous",
    with_points: bool = True,
) -> tuple[Inputs, Targets]:
    """Add noise to latents ``float32 [B, T, V, C, h, w]``, and drop conditions.

    ``with_points=False`` leaves out color and depth, for a network without their adapter.
    """
    sigma = sigmas_of(draws.level)
    single_frames = draws.single_frames < options.single_frames
    sample = _per_frame(sigma) * draws.noise + (1.0 - _per_frame(sigma)) * latents
    sample = torch.where(_per_clip(single_frames, 6), sample, _with_errors(sample, draws, options))
    caption = torch.where(_per_clip(_kept(draws.text, options.drop_text), 3), batch.caption, 0)
    inputs = Inputs(
        sample=sample,
        timestep=(sigma * _LEVELS).unsqueeze(-1).expand(sample.shape[:3]),
        text=batch.text[caption],
        pooled=batch.pooled[caption],
        layout=torch.cat(
            [
                _map(batch.boxes, _kept(draws.boxes, options.drop_boxes)),
                _map(batch.map, _kept(draws.map, options.drop_map)),
            ],
            dim=3,
        ),
        points=_points(batch, draws, options, depth) if with_points else None,
        ids=_ids(batch.ids, _kept(draws.action, options.drop_action)),
        mask=batch.mask,
        single_frames=single_frames,
    )
    return inputs, Targets(latents, sample, sigma)


def loss_of(velocity: Tensor, targets: Targets) -> Tensor:
    """Return the mean square error of the latents that a velocity ``[B, T, V, C, h, w]`` predicts."""
    predicted = targets.sample - _per_frame(targets.sigma) * velocity.float()
    return (predicted - targets.latents).square().mean()


def _with_errors(sample: Tensor, draws: Draws, options: StepOptions) -> Tensor:
    scale = 1.0 + options.input_scale_std * draws.input_scale
    return sample * _per_frame(scale) + _per_frame(options.input_offset_std * draws.input_offset)


def _kept(draw: Tensor, drop: float) -> Tensor:
    """Whether a condition is kept: ``bool [B]``."""
    return draw < 1.0 - drop


def _map(image: Tensor, kept: Tensor) -> Tensor:
    """Convert an image ``uint8 [B, T, V, 3, H, W]`` to values of 0 to 1, or to the value of a dropped one."""
    return torch.where(_per_clip(kept, 6), image.float() / 255.0, NO_COLOR)


def _points(batch: Batch, draws: Draws, options: StepOptions, mode: DepthMode) -> Tensor:
    """Color and depth, ``float32 [B, T, V, 20, H, W]``."""
    # Unlike the other conditions, these are dropped where the number is small.
    color_kept, depth_kept = draws.color >= options.drop_color, draws.depth >= options.drop_depth
    bins = torch.where(_per_clip(depth_kept, 5), batch.depth_bins, 0)
    return torch.cat([_map(batch.color, color_kept), depth_channels(bins, batch.bin_count, mode)], dim=3)


def _ids(ids: Tensor, kept: Tensor) -> Tensor:
    """Drop speed and steering."""
    motion = torch.where(_per_clip(kept, 4), ids[..., -MOTION_IDS:], DROPPED_MOTION)
    return torch.cat([ids[..., :-MOTION_IDS], motion], dim=-1)


def _per_clip(values: Tensor, dimensions: int) -> Tensor:
    """Expand ``[B]`` to be broadcast to so many dimensions."""
    return values.view(-1, *[1] * (dimensions - 1))


def _per_frame(values: Tensor) -> Tensor:
    """Expand ``[B, T]`` to be broadcast to latents."""
    return values[:, :, None, None, None, None]
