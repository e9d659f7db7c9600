"""Images of whole clips from noise, for validations of a training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from .draws import Draws
from .step import Batch, Inputs, StepOptions, Texts, conditioned, shifted

__all__ = ["sample"]


def sample(
    network: Callable[[Inputs], Tensor],
    batch: Batch,
    texts: Texts,
    noise: Tensor,
    options: StepOptions,
    *,
    steps: int,
    guidance: float,
) -> Tensor:
    """Integrate the velocity from noise to latents ``float32 [B, T, V, C, h, w]``, all frames at one level.

    Of ``options`` the kinds of conditions are used, not the dropouts.
    """
    draws = _draws(noise)
    kept = replace(options, drop_depth=0.0, drop_color=0.0, single_frames=0.0)
    # The second half of guidance is without text, layout and motion.
    halves = [replace(kept, drop_text=drop, drop_boxes=drop, drop_map=drop, drop_action=drop) for drop in (0.0, 1.0)]
    sigmas = [*shifted(torch.linspace(1.0, 1e-3, steps, dtype=torch.float64)).tolist(), 0.0]
    latents = noise
    for sigma, after in zip(sigmas, sigmas[1:]):
        timestep = torch.full(latents.shape[:3], sigma * 1000.0, device=latents.device)
        with_all, without = (
            network(conditioned(batch, texts, latents, timestep, draws, half)).float() for half in halves
        )
        latents = latents + (after - sigma) * (without + guidance * (with_all - without))
    return latents


def _draws(noise: Tensor) -> Draws:
    """Numbers with which a dropout of 1 always drops, and one of 0 never."""
    half = torch.full(noise.shape[:1], 0.5, device=noise.device)
    per_frame = torch.zeros(noise.shape[:2], device=noise.device)
    given = {"posterior_noise": noise, "noise": noise}
    given |= dict.fromkeys(("level", "input_scale", "input_offset"), per_frame)
    return Draws(**{name: given.get(name, half) for name in Draws._fields})
