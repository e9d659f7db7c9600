"""Images and latents: the variational autoencoder of Stable Diffusion 3."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from diffusers import AutoencoderKL
from torch import Tensor

from .._files import first_line

__all__ = ["LATENT_SCALE", "ImageCodec"]

LATENT_SCALE = 8
"""Pixels per latent, in height and width."""


class ImageCodec:
    """Encodes images as latents ``(z - shift) * scale`` and decodes them, in single precision."""

    def __init__(self, vae: Any, device: str | torch.device = "cpu") -> None:
        self.vae = vae.to(device, torch.float32).eval()
        self.device = torch.device(device)
        self.shift: float = vae.config.shift_factor or 0.0
        self.scale: float = vae.config.scaling_factor

    @classmethod
    def load(cls, folder: Path, channels: int, device: str | torch.device = "cpu") -> ImageCodec:
        """Read a folder of ``AutoencoderKL``.

        Raises ``ValueError``, which names the folder, if it cannot be read, or if its latents do not have
        ``channels`` channels and an eighth of the image size.
        """
        try:
            vae = AutoencoderKL.from_pretrained(folder, torch_dtype=torch.float32, local_files_only=True)
        except Exception as error:  # of many kinds, by what the files are
            raise ValueError(f"expected a variational autoencoder, found {first_line(error)}: {folder}") from error
        found = vae.config.latent_channels, 2 ** (len(vae.config.block_out_channels) - 1)
        if found != (channels, LATENT_SCALE):
            raise ValueError(
                f"expected latents of {channels} channels at 1/{LATENT_SCALE} of the size of images, "
                f"found {found[0]} at 1/{found[1]}: {folder}"
            )
        return cls(vae, device)

    def encode(self, images: Tensor) -> Tensor:
        """Encode RGB images ``[N, 3, H, W]`` of 0 to 1 as the mode of the posterior, ``float32 [N, C, H/8, W/8]``."""
        with torch.inference_mode(), torch.autocast(self.device.type, enabled=False):
            latents: Tensor = self.vae.encode(images.to(self.device, torch.float32) * 2.0 - 1.0).latent_dist.mode()
            return self.scaled(latents)

    def posterior(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Encode images as for ``encode``; returns mean and deviation of the posterior, before shift and scale.

        Always in single precision. Unlike the results of ``encode``, these may be inputs of a network in training.
        """
        with torch.no_grad(), torch.autocast(self.device.type, enabled=False):
            distribution = self.vae.encode(images.to(self.device, torch.float32) * 2.0 - 1.0).latent_dist
            return distribution.mean, distribution.std

    def sample(self, images: Tensor, noise: Tensor, at_once: int) -> Tensor:
        """Encode images ``uint8 [.., 3, H, W]`` as samples of the posterior, ``float32 [.., C, H/8, W/8]``.

        ``noise`` is normal and has the shape of the result; with 0 it is the mode. ``at_once`` images are encoded at a time.
        """
        parts = torch.split(images.flatten(0, -4), at_once)
        moments = [self.posterior(part.to(self.device).float() / 255.0) for part in parts]
        mean, std = (torch.cat(values).view(noise.shape) for values in zip(*moments))
        return self.scaled(mean + std * noise)

    def scaled(self, z: Tensor) -> Tensor:
        """Shift and scale values ``z`` of the posterior to latents."""
        return (z - self.shift) * self.scale

    def decode(self, latents: Tensor) -> Tensor:
        """Decode latents ``[N, C, h, w]`` to RGB images ``float32 [N, 3, 8 h, 8 w]`` of 0 to 1."""
        with torch.inference_mode(), torch.autocast(self.device.type, enabled=False):
            images: Tensor = self.vae.decode(latents.to(self.device, torch.float32) / self.scale + self.shift).sample
            return (images / 2.0 + 0.5).clamp(0.0, 1.0)
