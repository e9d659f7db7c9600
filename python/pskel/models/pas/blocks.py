"""Parts of the network beside the blocks of Stable Diffusion 3.5."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from diffusers.models.adapter import AdapterBlock
from diffusers.models.attention import FeedForward
from diffusers.models.normalization import RMSNorm
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

from .config import AdapterConfig

__all__ = ["AlphaBlender", "ImageAdapter", "SelfAttentionBlock"]


def _call(block: nn.Module, x: Tensor) -> Tensor:
    out: Tensor = block(x)
    return out


class ImageAdapter(nn.Module):
    """Encodes condition maps as residuals of the first blocks of a transformer (T2I-Adapter, arXiv:2302.08453)."""

    def __init__(self, config: AdapterConfig) -> None:
        super().__init__()
        self.unshuffle = nn.PixelUnshuffle(config.downscale_factor)
        inputs = [config.in_channels * config.downscale_factor**2, *config.channels]
        self.body = nn.ModuleList(
            AdapterBlock(before, after, config.num_res_blocks, down=down)
            for before, after, down in zip(inputs, config.channels, config.is_downblocks)
        )
        self.zero_convs = nn.ModuleList(nn.Conv2d(channels, channels, 1) for channels in config.channels)
        for convolution in self.zero_convs.parameters():
            nn.init.zeros_(convolution)

    def forward(self, maps: Tensor, run: Callable[[nn.Module, Tensor], Any] = _call) -> list[Tensor]:
        """Encode maps ``[N, C, H, W]``; returns a residual ``[N, tokens, channels]`` per block. ``run`` applies a block."""
        x = self.unshuffle(maps)
        residuals = []
        for block, convolution in zip(self.body, self.zero_convs):
            x = run(block, x)
            residuals.append(convolution(x).flatten(2).transpose(1, 2))
        return residuals


class SelfAttention(nn.Module):
    """Multi-head self-attention with normalized queries and keys."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_q = nn.Linear(dim, dim, bias=False)
        self.to_k = nn.Linear(dim, dim, bias=False)
        self.to_v = nn.Linear(dim, dim, bias=False)
        self.norm_q = RMSNorm(dim // heads, eps=1e-5)
        self.norm_k = RMSNorm(dim // heads, eps=1e-5)
        self.to_out = nn.ModuleList([nn.Linear(dim, dim)])

    def forward(self, x: Tensor, mask: Tensor | None = None) -> Tensor:
        query, key, value = (
            project(x).view(*x.shape[:2], self.heads, -1).transpose(1, 2) for project in (self.to_q, self.to_k, self.to_v)
        )
        attended = scaled_dot_product_attention(self.norm_q(query), self.norm_k(key), value, attn_mask=mask)
        out: Tensor = self.to_out[0](attended.transpose(1, 2).flatten(2))
        return out


class SelfAttentionBlock(nn.Module):
    """Transformer block over tokens of several cameras or frames."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.norm_in = nn.LayerNorm(dim)
        self.ff_in = FeedForward(dim, activation_fn="geglu")
        self.norm1 = nn.LayerNorm(dim)
        self.attn1 = SelfAttention(dim, heads)
        self.norm3 = nn.LayerNorm(dim)
        self.ff = FeedForward(dim, activation_fn="geglu")

    def forward(self, x: Tensor, mask: Tensor | None = None) -> Tensor:
        """Transform tokens ``[N, tokens, dim]``.

        ``mask`` is a ``bool`` that broadcasts to ``[N, heads, queries, keys]``, true where a query sees a key.
        """
        x = x + self.ff_in(self.norm_in(x))
        x = x + self.attn1(self.norm1(x), mask)
        x = x + self.ff(self.norm3(x))
        return x


class AlphaBlender(nn.Module):
    """Blends tokens with a block's output tokens by a learned weight."""

    def __init__(self, merge_factor: float) -> None:
        super().__init__()
        self.mix_factor = nn.Parameter(torch.tensor([float(merge_factor)]))

    def forward(self, x: Tensor, transformed: Tensor, disabled: Tensor | None) -> Tensor:
        """Blend ``[B, ..]``; clips with a true value in ``disabled`` ``bool [B]`` remain ``x``."""
        alpha = self.mix_factor.sigmoid()
        if disabled is not None:
            alpha = torch.where(disabled, 1.0, alpha)
        alpha = alpha.to(x.dtype).view(-1, *[1] * (x.ndim - 1))
        return alpha * x + (1.0 - alpha) * transformed
