"""The training step: network inputs and loss of a batch, as a function of explicit draws.

It equals the step of the paper's authors: diffusion forcing (arXiv:2407.01392) with an independent noise level for each
frame, flow matching (arXiv:2403.03206), dropouts of conditions, and errors in the noisy latents. Options add the noise
levels of rolls and clean reference frames. Nothing is drawn here.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..._condition import DROPPED_MOTION, NO_COLOR
from ..ids import MOTION_IDS
from .depth import DEPTH_MODES, DepthMode, depth_channels
from .draws import Draws

__all__ = [
    "Batch",
    "Inputs",
    "StepOptions",
    "Targets",
    "Texts",
    "conditioned",
    "levels_of",
    "loss_of",
    "noisy_inputs",
    "shifted",
    "sigmas_of",
]

_LEVELS = 1000
_SHIFT = 3.0


@dataclass(frozen=True)
class StepOptions:
    """Probabilities of the dropouts, deviations of the errors, and conditions; the defaults are the authors'.

    Raises ``ValueError`` for a probability that is not between 0 and 1, for a negative deviation, and for another
    depth.
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
    roll_levels: float = 0.0
    """Share of clips whose frames have the noise levels of a roll, rising from frame to frame."""
    clean_references: float = 0.0
    """Share of clips whose first frames, one or more but not all, have the lowest level, as references of a rollout."""
    depth: DepthMode = "continuous"
    """``continuous``, or ``both``, with sines and cosines."""
    with_points: bool = True
    """Whether color and depth are conditions; without them, their adapter is not used."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            most = float("inf") if field.name.endswith("_std") else 1.0
            if isinstance(field.default, float) and not 0.0 <= value <= most:
                raise ValueError(f"expected {field.name} of 0 to {most:g}, found {value}")
        if self.depth not in DEPTH_MODES:
            raise ValueError(f"expected depth of {' or '.join(DEPTH_MODES)}, found {self.depth!r}")


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


class Texts(NamedTuple):
    """Encoded ``Batch.texts``."""

    tokens: Tensor
    """``[N, S, D]``."""
    pooled: Tensor
    """``[N, P]``."""


class Inputs:
    """Arguments of the network, see ``Network.forward`` and ``Network.encode_conditions``.

    A class of its own, not a tuple of tensors: FSDP may round tensors among the arguments to half precision, but
    timesteps and ``ids`` need more digits.
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


def sigmas_of(level: Tensor) -> Tensor:
    """Return the noise levels of normal numbers, of any shape: logit-normal, of the 1000 steps with shift 3."""
    return _table(level.device)[_index(level.sigmoid())]


def levels_of(draws: Draws, options: StepOptions) -> Tensor:
    """Return the noise level of each frame, ``[B, T]``.

    In a roll over T frames, frame j has the time (j + u) / T, with the same u between 0 and 1 for all frames: the window
    of Reset-and-Roll after some of the inference steps of a roll. References have the last level of the table.
    """
    index = _index(draws.level.sigmoid())
    count = index.shape[1]
    frames = torch.arange(count, device=index.device)
    rolled = _index(1.0 - (frames + draws.roll_place.unsqueeze(-1)) / count)
    index = torch.where((draws.roll < options.roll_levels).unsqueeze(-1), rolled, index)
    known = 1 + (draws.reference_count * (count - 1)).floor()
    known = torch.where(draws.references < options.clean_references, known, 0.0)
    return _table(index.device)[torch.where(frames < known.unsqueeze(-1), _LEVELS - 1, index)]


def _index(progress: Tensor) -> Tensor:
    """Return places in the table for the progress of denoising, 0 for noise to 1 for images."""
    return (progress * _LEVELS).floor().clamp(0, _LEVELS - 1).long()


def _table(device: torch.device) -> Tensor:
    return shifted(torch.arange(_LEVELS, 0, -1, dtype=torch.float32, device=device) / _LEVELS)


def shifted(time: Tensor) -> Tensor:
    """Return the noise levels of evenly spaced times, 1 for noise to 0 for images."""
    return _SHIFT * time / (1.0 + (_SHIFT - 1.0) * time)


def noisy_inputs(
    batch: Batch,
    texts: Texts,
    latents: Tensor,
    draws: Draws,
    options: StepOptions = StepOptions(),
) -> tuple[Inputs, Targets]:
    """Add noise to latents ``float32 [B, T, V, C, h, w]``, and drop conditions."""
    sigma = levels_of(draws, options)
    single_frames = draws.single_frames < options.single_frames
    sample = _per_frame(sigma) * draws.noise + (1.0 - _per_frame(sigma)) * latents
    sample = torch.where(_per_clip(single_frames, 6), sample, _with_errors(sample, draws, options))
    timestep = (sigma * _LEVELS).unsqueeze(-1).expand(sample.shape[:3])
    return conditioned(batch, texts, sample, timestep, draws, options), Targets(latents, sample, sigma)


def conditioned(
    batch: Batch,
    texts: Texts,
    sample: Tensor,
    timestep: Tensor,
    draws: Draws,
    options: StepOptions,
) -> Inputs:
    """Join noisy latents ``[B, T, V, C, h, w]``, timesteps ``[B, T, V]``, and the conditions that are not dropped."""
    caption = torch.where(_per_clip(_kept(draws.text, options.drop_text), 3), batch.caption, 0)
    boxes = _map(batch.boxes, _kept(draws.boxes, options.drop_boxes))
    road = _map(batch.map, _kept(draws.map, options.drop_map))
    return Inputs(
        sample=sample,
        timestep=timestep,
        text=texts.tokens[caption],
        pooled=texts.pooled[caption],
        layout=torch.cat([boxes, road], dim=3),
        points=_points(batch, draws, options) if options.with_points else None,
        ids=_ids(batch.ids, _kept(draws.action, options.drop_action)),
        mask=batch.mask,
        single_frames=draws.single_frames < options.single_frames,
    )


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


def _points(batch: Batch, draws: Draws, options: StepOptions) -> Tensor:
    """Color and depth, ``float32 [B, T, V, 20, H, W]``."""
    # Unlike the other conditions, these are dropped where the number is small.
    color_kept, depth_kept = draws.color >= options.drop_color, draws.depth >= options.drop_depth
    bins = torch.where(_per_clip(depth_kept, 5), batch.depth_bins, 0)
    return torch.cat([_map(batch.color, color_kept), depth_channels(bins, batch.bin_count, options.depth)], dim=3)


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
