"""Preconditioning of the denoiser: its input and output at a noise level.

A noisy latent is ``x = (1-s) x0 + s e``. The conditions of a place give a guess ``mu`` of ``x0``, whose error has a standard
deviation ``p`` per channel. With ``y = x - (1-s) mu`` and ``D = (1-s)^2 p^2 + s^2``, the best linear estimate of ``x0`` is
``mu + a y`` with ``a = (1-s) p^2 / D``; its error has the variance ``c^2 = s^2 p^2 / D``. The denoiser's input is ``y / sqrt D``,
its output ``F`` is that error in units of ``c``: ``x0 = mu + a y + c F``. Source: Karras et al., "Elucidating the Design Space
of Diffusion-Based Generative Models", 2022, section 5, for ``mu = 0`` and a single ``p``.
"""

from __future__ import annotations

import torch
from torch import Tensor

SIGMA_MIN = 0.005
"""Minimum noise level in the computation of velocities, and of frames that are not finished."""


class Levels:
    """Factors for noise levels ``[B, L]`` and errors ``[C]`` of the guess. Latents are ``[B, L, V, C, h, w]``."""

    def __init__(self, sigmas: Tensor, priors: Tensor) -> None:
        self._s = sigmas[:, :, None, None, None, None]
        self._p = priors[:, None, None]
        self._variance = (1 - self._s) ** 2 * self._p**2 + self._s**2

    def _residual(self, noisy: Tensor, guess: Tensor) -> Tensor:
        return noisy - (1 - self._s) * guess

    def shown(self, noisy: Tensor, guess: Tensor) -> Tensor:
        """Return the denoiser's input."""
        return self._residual(noisy, guess) / self._variance.sqrt()

    def clean(self, noisy: Tensor, guess: Tensor, answer: Tensor) -> Tensor:
        """Return the clean latents that an answer means."""
        known = self._residual(noisy, guess) * ((1 - self._s) * self._p**2 / self._variance)
        return guess + known + answer * (self._s * self._p / self._variance.sqrt())

    def answer(self, clean: Tensor, guess: Tensor, noise: Tensor) -> Tensor:
        """Return the target: the answer for which ``clean`` returns the clean latents of ``(1-s) x0 + s e``."""
        off = (clean - guess) * (self._s / (self._p * self._variance.sqrt()))
        return off - noise * ((1 - self._s) * self._p / self._variance.sqrt())

    def velocity(self, noisy: Tensor, clean: Tensor) -> Tensor:
        """Return the velocity of flow matching that leads to clean latents."""
        return (noisy - clean) / torch.clamp(self._s, min=SIGMA_MIN)
