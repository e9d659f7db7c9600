"""The denoising network: Stable Diffusion 3.5 Medium with attention across cameras and frames, and two adapters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from diffusers.models.attention import JointTransformerBlock
from diffusers.models.embeddings import CombinedTimestepTextProjEmbeddings, PatchEmbed, TimestepEmbedding
from diffusers.models.normalization import AdaLayerNormContinuous
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from .blocks import AlphaBlender, ImageAdapter, SelfAttentionBlock
from .config import ID_CHANNELS, Config

__all__ = ["Conditions", "Network", "add_residuals"]

_COLOR_CHANNELS = 3
_DEPTH_SCALE = 0.5


class Conditions(NamedTuple):
    """Encoded conditions of B clips with T frames and V cameras; tokens have D channels."""

    residuals: tuple[Tensor, ...]
    """For each of the first blocks ``[B, T, V, tokens, D]``, of both adapters."""
    text: Tensor
    """Tokens of the prompts, ``[B, T, V, S, D]``."""
    pooled: Tensor
    """Pooled prompts, ``[B, T, V, D]``."""
    view: Tensor
    """Cameras and motion, ``[B, T, V, D]``."""

    @classmethod
    def concatenate(cls, parts: Sequence[Conditions], dim: int) -> Conditions:
        """Join conditions of clips (``dim=0``), for guidance, or of frames (``dim=1``), for a window."""
        residuals, text, pooled, view = zip(*parts)
        return cls(
            tuple(torch.cat(block, dim) for block in zip(*residuals)),
            torch.cat(text, dim),
            torch.cat(pooled, dim),
            torch.cat(view, dim),
        )


class Network(nn.Module):
    """Predicts the velocity (noise less latents) for noisy latents, over all frames and cameras of a window.

    Parameter and buffer names match the published checkpoints. All inputs are converted to the device and,
    except timesteps and ``added_time_ids``, to the type of the parameters. Sources: *Point as Skeleton*;
    OpenDWM (github.com/SenseTime-FVG/OpenDWM); Stable Diffusion 3, arXiv:2403.03206.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.checkpoint_activations = False
        """Whether blocks are computed again in the backward pass, so that only their inputs stay in memory."""
        dim, heads = config.inner_dim, config.num_attention_heads
        self.pos_embed = PatchEmbed(
            height=config.sample_size,
            width=config.sample_size,
            patch_size=config.patch_size,
            in_channels=config.in_channels,
            embed_dim=dim,
            pos_embed_max_size=config.pos_embed_max_size,
        )
        self.time_text_embed = CombinedTimestepTextProjEmbeddings(dim, config.pooled_projection_dim)
        self.context_embedder = nn.Linear(config.joint_attention_dim, dim)
        self.view_embedding = TimestepEmbedding(config.projection_class_embeddings_input_dim, dim)
        self.condition_image_adapter = ImageAdapter(config.condition_image_adapter_config)
        self.condition_pc_adapter = ImageAdapter(config.condition_pc_adapter_config)
        self.transformer_blocks = nn.ModuleList(
            JointTransformerBlock(
                dim,
                heads,
                config.attention_head_dim,
                context_pre_only=layer == config.num_layers - 1,
                qk_norm="rms_norm",
                use_dual_attention=layer in config.dual_attention_layers,
            )
            for layer in range(config.num_layers)
        )
        crossview, temporal = config.crossview_block_layers, config.temporal_block_layers
        self.view_pos_embeds = nn.ModuleList(TimestepEmbedding(dim, 4 * dim, out_dim=dim) for _ in crossview)
        self.crossview_transformer_blocks = nn.ModuleList(SelfAttentionBlock(dim, heads) for _ in crossview)
        self.view_mixers = nn.ModuleList(AlphaBlender(config.merge_factor) for _ in crossview)
        self.time_pos_embeds = nn.ModuleList(TimestepEmbedding(dim, 4 * dim, out_dim=dim) for _ in temporal)
        self.temporal_transformer_blocks = nn.ModuleList(SelfAttentionBlock(dim, heads) for _ in temporal)
        self.time_mixers = nn.ModuleList(AlphaBlender(config.merge_factor) for _ in temporal)
        self.norm_out = AdaLayerNormContinuous(dim, dim, elementwise_affine=False, eps=1e-6)
        self.proj_out = nn.Linear(dim, config.patch_size**2 * config.out_channels)

    def encode_conditions(
        self,
        encoder_hidden_states: Tensor,
        pooled_projections: Tensor,
        layout: Tensor,
        points: Tensor,
        added_time_ids: Tensor,
    ) -> Conditions:
        """Encode the inputs that depend neither on latents nor on timesteps.

        - ``encoder_hidden_states`` ``[B, T, V, S, 4096]``: prompt tokens, 77 from CLIP-L and CLIP-G (2048
          channels, padded with zeros), then 77 from T5,
        - ``pooled_projections`` ``[B, T, V, 2048]``: pooled CLIP-L (768), then CLIP-G (1280),
        - ``layout`` ``[B, T, V, 6, H, W]``: boxes and map, RGB of 0 to 1,
        - ``points`` ``[B, T, V, 20, H, W]``: color (RGB of 0 to 1), depth (0 to 1, -1 where empty), its sines and cosines,
          or zeros in their place,
        - ``added_time_ids`` ``[B, T, V, 13]``: see the function of this name.

        Frames are encoded one by one, so that the result does not depend on their grouping. Raises
        ``ValueError`` if B, T and V differ.
        """
        leading = layout.shape[:3]
        _expect_leading(
            leading,
            encoder_hidden_states=encoder_hidden_states,
            pooled_projections=pooled_projections,
            points=points,
            added_time_ids=added_time_ids,
        )

        def encode(clip: int, frame: int) -> Conditions:
            at = slice(clip, clip + 1), slice(frame, frame + 1)
            text, pooled = self.encode_text(encoder_hidden_states[at], pooled_projections[at])
            residuals = add_residuals(self.encode_layout(layout[at]), self.encode_points(points[at]))
            return Conditions(residuals, text, pooled, self.encode_view(added_time_ids[at]))

        clips, frames = range(leading[0]), range(leading[1])
        parts = [Conditions.concatenate([encode(clip, frame) for frame in frames], dim=1) for clip in clips]
        return Conditions.concatenate(parts, dim=0)

    def encode_layout(self, layout: Tensor) -> tuple[Tensor, ...]:
        """Encode ``layout`` ``[B, T, V, 6, H, W]``; returns residuals ``[B, T, V, tokens, D]`` of the first blocks."""
        return self._residuals(self.condition_image_adapter, self._converted(layout))

    def encode_points(self, points: Tensor) -> tuple[Tensor, ...]:
        """Encode ``points`` ``[B, T, V, 20, H, W]``; returns residuals ``[B, T, V, tokens, D]`` of the first blocks."""
        maps = self._converted(points)
        maps = torch.cat([maps[:, :, :, :_COLOR_CHANNELS], _DEPTH_SCALE * maps[:, :, :, _COLOR_CHANNELS:]], dim=3)
        return self._residuals(self.condition_pc_adapter, maps)

    def encode_text(self, encoder_hidden_states: Tensor, pooled_projections: Tensor) -> tuple[Tensor, Tensor]:
        """Encode ``text`` and ``pooled`` of ``Conditions``."""
        text: Tensor = self.context_embedder(self._converted(encoder_hidden_states))
        pooled: Tensor = self.time_text_embed.text_embedder(self._converted(pooled_projections))
        return text, pooled

    def encode_view(self, added_time_ids: Tensor) -> Tensor:
        """Encode ``view`` of ``Conditions``."""
        view: Tensor = self.view_embedding(self._sinusoids(added_time_ids, ID_CHANNELS).flatten(-2))
        return view

    def _residuals(self, adapter: nn.Module, maps: Tensor) -> tuple[Tensor, ...]:
        return tuple(x.view(*maps.shape[:3], *x.shape[1:]) for x in adapter(maps.flatten(0, 2), self._run))

    def _run(self, block: Callable[..., Any], *inputs: Any) -> Any:
        """Apply a block, which is computed again in the backward pass if ``checkpoint_activations``."""
        if self.checkpoint_activations and torch.is_grad_enabled():
            return checkpoint(block, *inputs, use_reentrant=False, preserve_rng_state=False)  # no block draws numbers
        return block(*inputs)

    def forward(
        self,
        sample: Tensor,
        timestep: Tensor,
        conditions: Conditions,
        crossview_attention_mask: Tensor | None = None,
        disable_crossview: Tensor | None = None,
        disable_temporal: Tensor | None = None,
    ) -> Tensor:
        """Return the velocity ``[B, T, V, 16, H/8, W/8]`` of noisy latents ``sample`` of this shape.

        ``timestep`` ``[B, T, V]`` is the noise level of each frame and camera, 1000 times its sigma. Camera i sees camera j
        where ``crossview_attention_mask`` ``bool [B, V, V]`` is true at i, j (without it, all). ``disable_crossview`` and
        ``disable_temporal`` ``bool [B]`` switch attention across cameras and frames off for clips. Raises ``ValueError`` if
        B, T and V differ.
        """
        leading = sample.shape[:3]
        _expect_leading(leading, timestep=timestep, conditions=conditions.pooled)
        frames = leading[1]
        rows, columns = (size // self.config.patch_size for size in sample.shape[-2:])
        mask = self._flags(crossview_attention_mask)
        if mask is not None:
            mask = _row_mask(mask, frames, rows, columns)
        disable_crossview, disable_temporal = self._flags(disable_crossview), self._flags(disable_temporal)
        levels = self._sinusoids(timestep, ID_CHANNELS)
        time = (self.time_text_embed.timestep_embedder(levels) + conditions.pooled).flatten(0, 2)
        text = conditions.text.flatten(0, 2)
        view = conditions.view.unsqueeze(3)
        x: Tensor = self.pos_embed(self._converted(sample).flatten(0, 2)).view(*leading, rows * columns, -1)
        for layer, block in enumerate(self.transformer_blocks):
            if layer < len(conditions.residuals):
                x = x + conditions.residuals[layer]
            text, tokens = self._run(block, x.flatten(0, 2), text, time)
            x = tokens.view(x.shape)
            if layer in self.config.temporal_block_layers:
                index = self.config.temporal_block_layers.index(layer)
                x = self._run(partial(self._mix_frames, index), x, view, disable_temporal)
            if layer in self.config.crossview_block_layers:
                index = self.config.crossview_block_layers.index(layer)
                x = self._run(partial(self._mix_views, index, columns), x, view, mask, disable_crossview)
        patches = self.proj_out(self.norm_out(x.flatten(0, 2), time))
        return _unpatchified(patches, rows, columns, self.config.patch_size).view(*leading, -1, *sample.shape[-2:])

    def _mix_frames(self, index: int, x: Tensor, view: Tensor, disabled: Tensor | None) -> Tensor:
        """Blend tokens ``[B, T, V, tokens, D]`` with a block's output over the frames at the same position."""
        frames = x.shape[1]
        embedding = view + self._indices(self.time_pos_embeds[index], frames).view(frames, 1, 1, -1)
        transformed = _over_frames(self.temporal_transformer_blocks[index], x + embedding)
        mixed: Tensor = self.time_mixers[index](x, transformed, disabled)
        return mixed

    def _mix_views(
        self, index: int, columns: int, x: Tensor, view: Tensor, mask: Tensor | None, disabled: Tensor | None
    ) -> Tensor:
        """Blend tokens ``[B, T, V, rows * columns, D]`` with a block's output over the cameras in the same row."""
        views = x.shape[2]
        embedding = view + self._indices(self.view_pos_embeds[index], views).view(views, 1, -1)
        transformed = _over_views(self.crossview_transformer_blocks[index], x + embedding, columns, mask)
        mixed: Tensor = self.view_mixers[index](x, transformed, disabled)
        return mixed

    def _converted(self, x: Tensor) -> Tensor:
        return x.to(self.proj_out.weight)

    def _flags(self, x: Tensor | None) -> Tensor | None:
        return None if x is None else x.to(self.proj_out.weight.device, torch.bool)

    def _sinusoids(self, x: Tensor, channels: int) -> Tensor:
        """Embed numbers ``[..]`` as cosines and sines ``[.., channels]``; in ``float32``, since timesteps are up to 1000."""
        values = x.to(self.proj_out.weight.device, torch.float32)
        angles = values.unsqueeze(-1) * _frequencies(channels // 2).to(values.device)
        return self._converted(torch.cat([angles.cos(), angles.sin()], dim=-1))

    def _indices(self, embed: nn.Module, count: int) -> Tensor:
        """Embed the indices of frames or cameras, ``[count, D]``."""
        indices = torch.arange(count, device=self.proj_out.weight.device)
        embedded: Tensor = embed(self._sinusoids(indices, self.config.inner_dim))
        return embedded


def _frequencies(count: int) -> Tensor:
    """Frequencies of the sinusoids, 1 down to 1e-4.

    ``get_timestep_embedding`` of diffusers takes the exponential in ``float32``, which differs in the last bit from processor
    to processor. With timesteps up to 1000 this is a visible part of the error, so it is taken in ``float64``.
    """
    exponents = -math.log(1e4) * torch.arange(count, dtype=torch.float32, device="cpu") / count
    return exponents.double().exp().float()


def add_residuals(layout: Sequence[Tensor], points: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """Add the residuals of both adapters, block by block."""
    return tuple(image + point for image, point in zip(layout, points))


def _expect_leading(leading: torch.Size, **tensors: Tensor) -> None:
    for name, tensor in tensors.items():
        if tensor.shape[:3] != leading:
            found = list(tensor.shape[:3])
            raise ValueError(f"expected {name} of {list(leading)} clips, frames and cameras, found {found}")


def _row_mask(mask: Tensor, frames: int, rows: int, columns: int) -> Tensor:
    """Expand a mask of cameras ``[B, V, V]`` to the tokens of each row, ``[B * T * rows, 1, V * columns, V * columns]``."""
    tokens = mask.repeat_interleave(columns, 1).repeat_interleave(columns, 2)
    return tokens.repeat_interleave(frames * rows, 0).unsqueeze(1)


def _over_frames(block: nn.Module, x: Tensor) -> Tensor:
    """Apply a block to the tokens at the same position in all frames; ``x`` is ``[B, T, V, tokens, D]``."""
    series = x.permute(0, 2, 3, 1, 4)
    out: Tensor = block(series.flatten(0, 2))
    return out.view(series.shape).permute(0, 3, 1, 2, 4)


def _over_views(block: nn.Module, x: Tensor, columns: int, mask: Tensor | None) -> Tensor:
    """Apply a block to the tokens in the same row of all cameras; ``x`` is ``[B, T, V, rows * columns, D]``."""
    rows = x.reshape(*x.shape[:3], -1, columns, x.shape[-1]).transpose(2, 3)
    out: Tensor = block(rows.flatten(3, 4).flatten(0, 2), mask)
    return out.view(rows.shape).transpose(2, 3).flatten(3, 4)


def _unpatchified(patches: Tensor, rows: int, columns: int, size: int) -> Tensor:
    """Arrange patches ``[N, rows * columns, size * size * C]`` as an image ``[N, C, rows * size, columns * size]``."""
    x = patches.view(len(patches), rows, columns, size, size, -1)
    return x.permute(0, 5, 1, 3, 2, 4).reshape(len(x), -1, rows * size, columns * size)
