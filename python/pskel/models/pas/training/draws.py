"""Random numbers of a training step."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["Draws", "generator_of"]


class Draws(NamedTuple):
    """All random numbers of a step over B clips with T frames; nothing else in a step is random.

    ``posterior_noise``, ``noise``, ``level``, ``input_scale`` and ``input_offset`` are normal, the others uniform
    between 0 and 1.
    """

    posterior_noise: Tensor
    """Of the autoencoder's posterior, ``[B, T, V, C, h, w]``."""
    noise: Tensor
    """Of the diffusion, ``[B, T, V, C, h, w]``."""
    level: Tensor
    """Noise level, before the sigmoid, ``[B, T]``."""
    text: Tensor
    """Of the dropout of a condition, ``[B]``; likewise the next five."""
    boxes: Tensor
    map: Tensor
    action: Tensor
    depth: Tensor
    color: Tensor
    input_scale: Tensor
    """Error of the noisy latents, ``[B, T]``; likewise the next."""
    input_offset: Tensor
    single_frames: Tensor
    """Of the choice of clips without attention across frames, ``[B]``."""
    roll: Tensor
    """Of the choice of clips with the noise levels of a roll, ``[B]``."""
    roll_place: Tensor
    """Progress of the roll, ``[B]``."""
    references: Tensor
    """Of the choice of clips with clean reference frames, ``[B]``."""
    reference_count: Tensor
    """Of their number, ``[B]``."""

    @classmethod
    def sample(cls, generator: torch.Generator, clips: int, latents: Sequence[int]) -> Draws:
        """Draw the numbers of ``clips`` clips, whose latents have the shape ``latents``, ``[T, V, C, h, w]``."""

        def normal(*shape: int) -> Tensor:
            return torch.randn(clips, *shape, generator=generator)

        def uniform() -> Tensor:
            return torch.rand(clips, generator=generator)

        frames = latents[0]
        return cls(
            posterior_noise=normal(*latents),
            noise=normal(*latents),
            level=normal(frames),
            text=uniform(),
            boxes=uniform(),
            map=uniform(),
            action=uniform(),
            depth=uniform(),
            color=uniform(),
            input_scale=normal(frames),
            input_offset=normal(frames),
            single_frames=uniform(),
            roll=uniform(),
            roll_place=uniform(),
            references=uniform(),
            reference_count=uniform(),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Draws]) -> Draws:
        """Join the draws of clips."""
        return cls(*(torch.cat(tensors) for tensors in zip(*parts)))

    def to(self, device: torch.device | str) -> Draws:
        """Copy to a device."""
        return Draws(*(tensor.to(device) for tensor in self))


def generator_of(*key: int | str) -> torch.Generator:
    """Return a generator on the CPU that depends on ``key`` alone."""
    digest = hashlib.blake2b(repr(key).encode(), digest_size=8).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest, "little") >> 1)
