"""Parts of the network beside the UNet of Stable Diffusion 1.5."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from diffusers import T2IAdapter
from diffusers.models.embeddings import get_timestep_embedding
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from ..pas.blocks import SelfAttention
from .config import LATENT_SCALE, Config

__all__ = ["Adapter", "AcrossFrames", "AcrossViews", "Window", "WindowTransformer"]

_COLUMN_RANGE = 1000.0
"""Positions of columns are 0 to this, as the timesteps for which the sinusoids were made."""


@dataclass
class Window:
    """Arrangement of the images in the UNet's present call, which its transformers share."""

    shape: tuple[int, int, int] = (1, 1, 1)
    """Clips B, frames T, cameras V."""
    views: Tensor | None = None
    """Embedded cameras and motion, ``[B, T, V, D]``."""
    mask: Tensor | None = None
    """``bool [B, V, V]``, true where a camera sees another."""
    single_frames: Tensor | None = None
    """``bool [B]``, true for clips without attention across frames."""
    checkpoint_activations: bool = False
    """Whether blocks are computed again in the backward pass."""


class Adapter(nn.Module):
    """Encodes condition maps as residuals of the UNet's down blocks, 0 before training (arXiv:2302.08453)."""

    def __init__(self, in_channels: int, config: Config) -> None:
        super().__init__()
        channels = list(config.block_out_channels)
        self.body = T2IAdapter(
            in_channels=in_channels,
            channels=channels,
            downscale_factor=LATENT_SCALE,
            adapter_type="full_adapter",
        )
        self.zero_convs = nn.ModuleList(nn.Conv2d(count, count, 1) for count in channels)
        for parameter in self.zero_convs.parameters():
            nn.init.zeros_(parameter)

    def forward(self, maps: Tensor) -> list[Tensor]:
        """Encode maps ``[N, C, H, W]``; returns a residual ``[N, channels, h, w]`` per down block."""
        return [convolution(features) for convolution, features in zip(self.zero_convs, self.body(maps))]


class _Across(nn.Module):
    """Attention to the tokens of other images, added to tokens; it adds 0 before training."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(channels)
        self.attention = SelfAttention(channels, heads)
        for parameter in self.attention.to_out.parameters():
            nn.init.zeros_(parameter)


class AcrossViews(_Across):
    """Attention to the same row of neighboring cameras."""

    def forward(self, x: Tensor, offset: Tensor, mask: Tensor | None) -> Tensor:
        """Return what is added to tokens ``x`` ``[B, T, V, h, w, C]``.

        ``offset`` ``[B, T, V, C]`` is added to the normalized tokens. ``mask`` is ``bool [B, V, V]``, true where a
        camera sees another.
        """
        _, frames, _, rows, columns, channels = x.shape
        tokens = self.norm(x) + offset[:, :, :, None, None] + _positions(_fractions(columns, x.device), channels).to(x)
        lines = tokens.permute(0, 1, 3, 2, 4, 5)
        if mask is not None:
            mask = mask.repeat_interleave(columns, 1).repeat_interleave(columns, 2)
            mask = mask.repeat_interleave(frames * rows, 0).unsqueeze(1)
        out: Tensor = self.attention(lines.flatten(3, 4).flatten(0, 2), mask)
        return out.view(lines.shape).permute(0, 1, 3, 2, 4, 5)


class AcrossFrames(_Across):
    """Attention to the same pixel of all frames."""

    def forward(self, x: Tensor, offset: Tensor) -> Tensor:
        """Return what is added to tokens ``x`` ``[B, T, V, h, w, C]``; ``offset`` as for ``AcrossViews``."""
        frames, channels = x.shape[1], x.shape[-1]
        places = _positions(torch.arange(frames, device=x.device), channels).to(x)
        tokens = self.norm(x) + (offset + places[:, None])[:, :, :, None, None]
        series = tokens.permute(0, 2, 3, 4, 1, 5)
        out: Tensor = self.attention(series.flatten(0, 3))
        return out.view(series.shape).permute(0, 4, 1, 2, 3, 5)


class WindowTransformer(nn.Module):
    """A spatial transformer of the UNet, then attention across cameras, then across frames."""

    def __init__(self, spatial: nn.Module, channels: int, heads: int, view_channels: int, window: Window) -> None:
        super().__init__()
        self.spatial = spatial
        self.view = nn.Linear(view_channels, channels)
        self.across_views = AcrossViews(channels, heads)
        self.across_frames = AcrossFrames(channels, heads)
        self.window = window

    def forward(self, hidden_states: Tensor, **options: object) -> tuple[Tensor]:
        """Transform images ``[B * T * V, C, h, w]``; ``options`` are for the spatial transformer."""
        x: Tensor = self.spatial(hidden_states, **{**options, "return_dict": False})[0]
        window = self.window
        if window.views is None:
            raise RuntimeError("expected a call of the whole network, found one of its UNet")
        inputs = x, window.shape, window.views, window.mask, window.single_frames
        if window.checkpoint_activations and torch.is_grad_enabled():
            return (checkpoint(self._across, *inputs, use_reentrant=False, preserve_rng_state=False),)
        return (self._across(*inputs),)

    def _across(
        self, x: Tensor, shape: tuple[int, int, int], views: Tensor, mask: Tensor | None, single_frames: Tensor | None
    ) -> Tensor:
        tokens = x.view(*shape, *x.shape[1:]).permute(0, 1, 2, 4, 5, 3)
        offset: Tensor = self.view(views)
        added: Tensor = self.across_views(tokens, offset, mask)
        of_frames: Tensor = self.across_frames(tokens + added, offset)
        if single_frames is not None:
            of_frames = torch.where(single_frames.view(-1, *[1] * (of_frames.ndim - 1)), 0.0, of_frames)
        return x + (added + of_frames).permute(0, 1, 2, 5, 3, 4).reshape(x.shape)


def _fractions(count: int, device: torch.device) -> Tensor:
    """Centers of ``count`` columns, so that a position means the same at all sizes."""
    return (torch.arange(count, device=device) + 0.5) * (_COLUMN_RANGE / count)


def _positions(places: Tensor, channels: int) -> Tensor:
    """Sinusoids of positions, ``float32 [N, channels]``."""
    embedded: Tensor = get_timestep_embedding(places, channels, flip_sin_to_cos=True, downscale_freq_shift=0)
    return embedded
