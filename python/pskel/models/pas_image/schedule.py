"""Noise levels of Stable Diffusion: ``x = sqrt(a) latents + sqrt(1 - a) noise``, ``a`` from a table of 1000 timesteps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import torch
from diffusers import DDPMScheduler
from torch import Tensor

from .config import Prediction

__all__ = ["LAST_TIMESTEP", "TIMESTEPS", "Schedule", "inference_timesteps"]

TIMESTEPS = 1000
LAST_TIMESTEP = 1
"""Level of the last inference step of ``--sampler ddim_..``, whatever their number: diffusers' ``steps_offset``."""


class Schedule:
    """Table of ``a``, the share of the latents in the variance, and what follows from it.

    Timesteps are per frame, ``[B, T]``, latents ``[B, T, ..]``. ``zero_snr``: see ``Config``.
    """

    def __init__(self, zero_snr: bool = False) -> None:
        self.zero_snr = zero_snr
        self.table = _table(zero_snr)

    def noisy(self, latents: Tensor, noise: Tensor, timesteps: Tensor) -> Tensor:
        """Add noise to latents."""
        signal, spread = self._factors(latents, timesteps)
        return signal * latents + spread * noise

    def target(self, prediction: Prediction, latents: Tensor, noise: Tensor, timesteps: Tensor) -> Tensor:
        """Return what the network is to predict."""
        if prediction == "epsilon":
            return noise
        signal, spread = self._factors(latents, timesteps)
        return signal * noise - spread * latents

    def step(self, prediction: Prediction, x: Tensor, output: Tensor, timesteps: Tensor, after: Tensor) -> Tensor:
        """Denoise ``x`` from ``timesteps`` to ``after``: DDIM with eta 0 (arXiv:2010.02502)."""
        signal, spread = self._factors(x, timesteps)
        if prediction == "epsilon":
            clean, noise = (x - spread * output) / signal, output
        else:
            clean, noise = signal * x - spread * output, signal * output + spread * x
        signal, spread = self._factors(x, after)
        return signal * clean + spread * noise

    def of_loop(self, timesteps: Sequence[float]) -> Tensor:
        """Return the levels of this table, ``float32 [L]``, that have the noise of timesteps in the loop's table.

        The loop has no table of zero signal at the last step. Without ``zero_snr`` both tables are the same. Raises
        ``ValueError`` for timesteps that are not in the table.
        """
        if wrong := [timestep for timestep in timesteps if timestep not in range(TIMESTEPS)]:
            raise ValueError(f"expected whole timesteps of 0 to {TIMESTEPS - 1}, found {wrong[0]:g}")
        index = [int(timestep) for timestep in timesteps]
        if not self.zero_snr:
            return torch.tensor(index, dtype=torch.float32)
        signals, wanted = self.table.double().sqrt(), _table(False).double().sqrt()[index]
        # The first timestep of the table before which the signal is not more than wanted.
        right = (signals[None] > wanted[:, None]).sum(dim=1).clamp(1, TIMESTEPS - 1)
        left = right - 1
        share = ((signals[left] - wanted) / (signals[left] - signals[right])).clamp(0.0, 1.0)
        return (left + share).float()

    def _factors(self, latents: Tensor, timesteps: Tensor) -> tuple[Tensor, Tensor]:
        a = self.table.to(latents.device)[timesteps.to(latents.device)]
        return _like(a.sqrt(), latents), _like((1.0 - a).sqrt(), latents)


def inference_timesteps(steps: int, zero_snr: bool = False) -> list[int]:
    """Return the timesteps of inference steps, descending.

    They are as with ``--sampler ddim_..``; with ``zero_snr``, they begin at the last one of the table. Raises
    ``ValueError`` for a number of steps that is not between 1 and 1000.
    """
    if not 1 <= steps <= TIMESTEPS:
        raise ValueError(f"expected inference steps of 1 to {TIMESTEPS}, found {steps}")
    ratio = TIMESTEPS // steps
    if zero_snr:
        return [TIMESTEPS - 1 - i * ratio for i in range(steps)]
    return [min(i * ratio + LAST_TIMESTEP, TIMESTEPS - 1) for i in reversed(range(steps))]


@lru_cache(maxsize=2)
def _table(zero_snr: bool) -> Tensor:
    scheduler = DDPMScheduler(
        num_train_timesteps=TIMESTEPS,
        beta_start=0.00085,
        beta_end=0.012,
        beta_schedule="scaled_linear",
        rescale_betas_zero_snr=zero_snr,
    )
    table: Tensor = scheduler.alphas_cumprod
    return table


def _like(values: Tensor, latents: Tensor) -> Tensor:
    """Expand values ``[B, T]`` to be broadcast to latents."""
    return values.reshape(*values.shape, *[1] * (latents.ndim - values.ndim))
