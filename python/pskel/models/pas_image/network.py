"""The denoising network: the UNet of Stable Diffusion 1.5 with adapters and attention across cameras and frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import torch
from diffusers import UNet2DConditionModel
from diffusers.models.embeddings import TimestepEmbedding, get_timestep_embedding
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from .blocks import Adapter, Window, WindowTransformer
from .config import Config

__all__ = ["IDS", "LAYOUT_CHANNELS", "POINT_CHANNELS", "Conditions", "Inputs", "Network", "add_residuals"]

LAYOUT_CHANNELS, POINT_CHANNELS = 6, 20
IDS = 13
"""Camera and motion numbers of an image, see ``pskel.models.pas.added_time_ids``."""
_ID_CHANNELS = 256
_COLOR_CHANNELS = 3
_DEPTH_SCALE = 0.5


class Conditions(NamedTuple):
    """Encoded conditions of B clips with T frames and V cameras."""

    residuals: tuple[Tensor, ...]
    """For each down block ``[B, T, V, C, h, w]``, of both adapters."""
    text: Tensor
    """Tokens of the prompts, ``[B, T, V, S, D]``."""
    view: Tensor
    """Cameras and motion, ``[B, T, V, D]``."""

    @classmethod
    def concatenate(cls, parts: Sequence[Conditions], dim: int) -> Conditions:
        """Join conditions of clips (``dim=0``) or of frames (``dim=1``)."""
        residuals, text, view = zip(*parts)
        return cls(
            tuple(torch.cat(block, dim) for block in zip(*residuals)), torch.cat(text, dim), torch.cat(view, dim)
        )


class Inputs:
    """Noisy latents and conditions of B clips, with which the network is called in training.

    A class of its own, not a tuple of tensors: FSDP rounds tensors among the arguments to half precision, but timesteps
    and ``ids`` need more digits.
    """

    def __init__(
        self,
        *,
        sample: Tensor,
        timestep: Tensor,
        text: Tensor,
        layout: Tensor,
        points: Tensor,
        ids: Tensor,
        mask: Tensor | None,
        single_frames: Tensor | None,
    ) -> None:
        self.sample = sample
        self.timestep = timestep
        self.text = text
        self.layout = layout
        self.points = points
        self.ids = ids
        self.mask = mask
        self.single_frames = single_frames


class Network(nn.Module):
    """Predicts the noise, or the velocity, of noisy latents over all frames and cameras of a window.

    Frames and cameras are items of the UNet's batch, each with its own level. Blocks across cameras and frames, the
    adapters and the view embedding add 0 before training, so that a new network is Stable Diffusion 1.5. All inputs are
    converted to the device and, except timesteps and ``ids``, to the type of the parameters. Sources: *Point as
    Skeleton*; Stable Diffusion, arXiv:2112.10752; T2I-Adapter, arXiv:2302.08453.
    """

    _no_split_modules: ClassVar[list[str]] = ["WindowTransformer", "ResnetBlock2D", "AdapterBlock"]
    """Classes of the modules that FSDP shards one by one, a name of diffusers and transformers."""

    def __init__(self, config: Config, unet: UNet2DConditionModel | None = None) -> None:
        """Create a network with random weights, or with the weights of ``unet``, which becomes a part of it."""
        super().__init__()
        self.config = config
        self.unet = UNet2DConditionModel(**config.unet) if unet is None else unet
        # The embedding is added to that of the timestep without further weights.
        self.unet.class_embedding = nn.Identity()
        self.unet.register_to_config(class_embed_type="identity")
        self.layout_adapter = Adapter(LAYOUT_CHANNELS, config)
        self.point_adapter = Adapter(POINT_CHANNELS, config)
        self.view_embedding = TimestepEmbedding(IDS * _ID_CHANNELS, config.time_channels)
        for parameter in self.view_embedding.linear_2.parameters():
            nn.init.zeros_(parameter)
        self._window = Window()
        for block in _transformer_blocks(self.unet):
            for index, transformer in enumerate(block.attentions):
                channels = transformer.config.in_channels
                block.attentions[index] = WindowTransformer(
                    transformer, channels, config.attention_head_dim, config.time_channels, self._window
                )

    def enable_checkpointing(self) -> None:
        """Compute blocks again in the backward pass, so that only their inputs stay in memory."""
        self.unet.enable_gradient_checkpointing()
        self._window.checkpoint_activations = True

    def encode_layout(self, layout: Tensor) -> tuple[Tensor, ...]:
        """Encode boxes and map ``[B, T, V, 6, H, W]``, 0 to 1; returns ``residuals`` of ``Conditions``."""
        return self._residuals(self.layout_adapter, self._converted(layout))

    def encode_points(self, points: Tensor) -> tuple[Tensor, ...]:
        """Encode points ``[B, T, V, 20, H, W]``: color, 0 to 1; depth, 0 to 1 or -1; its sines and cosines, or 0."""
        maps = self._converted(points)
        maps = torch.cat([maps[:, :, :, :_COLOR_CHANNELS], _DEPTH_SCALE * maps[:, :, :, _COLOR_CHANNELS:]], dim=3)
        return self._residuals(self.point_adapter, maps)

    def encode_view(self, ids: Tensor) -> Tensor:
        """Encode camera and motion numbers ``ids`` ``[B, T, V, 13]`` as ``view`` of ``Conditions``."""
        # In single precision: the numbers are -1000 where they are dropped.
        values = ids.to(self._device, torch.float32)
        embedded = get_timestep_embedding(values.flatten(), _ID_CHANNELS, flip_sin_to_cos=True, downscale_freq_shift=0)
        view: Tensor = self.view_embedding(self._converted(embedded).view(*ids.shape[:-1], -1))
        return view

    def encode_text(self, text: Tensor) -> Tensor:
        """Convert text tokens to the device and type of the parameters."""
        return self._converted(text)

    def forward(
        self,
        inputs: Inputs | Tensor,
        timestep: Tensor | None = None,
        conditions: Conditions | None = None,
        mask: Tensor | None = None,
    ) -> Tensor:
        """Return the noise, or the velocity, ``[B, T, V, 4, H/8, W/8]`` of noisy latents of this shape.

        The arguments are ``Inputs``; or noisy latents, ``timestep`` ``[B, T]`` (the level of each frame, 0 to 999),
        ``conditions`` and ``mask`` ``bool [B, V, V]``, true where a camera sees another (without it, all do). Raises
        ``ValueError`` if B, T and V differ.
        """
        if isinstance(inputs, Inputs):
            residuals = add_residuals(self.encode_layout(inputs.layout), self.encode_points(inputs.points))
            encoded = Conditions(residuals, self.encode_text(inputs.text), self.encode_view(inputs.ids))
            return self._denoised(inputs.sample, inputs.timestep, encoded, inputs.mask, inputs.single_frames)
        if timestep is None or conditions is None:
            raise ValueError("expected timestep and conditions with noisy latents, found none")
        return self._denoised(inputs, timestep, conditions, mask, None)

    def _denoised(
        self,
        sample: Tensor,
        timestep: Tensor,
        conditions: Conditions,
        mask: Tensor | None,
        single_frames: Tensor | None,
    ) -> Tensor:
        clips, frames, views = sample.shape[:3]
        for name, found, expected in (
            ("timestep", timestep.shape, (clips, frames)),
            ("text", conditions.text.shape[:3], (clips, frames, views)),
            ("view", conditions.view.shape[:3], (clips, frames, views)),
            ("mask", mask.shape if mask is not None else (clips, views, views), (clips, views, views)),
        ):
            if tuple(found) != expected:
                raise ValueError(f"expected {name} of {list(expected)} for the latents, found {list(found)}")
        window = self._window
        window.shape = clips, frames, views
        window.views, window.mask, window.single_frames = conditions.view, self._flags(mask), self._flags(single_frames)
        try:
            noise: Tensor = self.unet(
                self._converted(sample).flatten(0, 2),
                timestep.to(self._device, torch.float32)[:, :, None].expand(clips, frames, views).flatten(),
                encoder_hidden_states=conditions.text.flatten(0, 2),
                class_labels=conditions.view.flatten(0, 2),
                down_intrablock_additional_residuals=[residual.flatten(0, 2) for residual in conditions.residuals],
                return_dict=False,
            )[0]
        finally:
            window.views = window.mask = window.single_frames = None
        return noise.view(sample.shape).clone()  # FSDP warns of views

    def _residuals(self, adapter: nn.Module, maps: Tensor) -> tuple[Tensor, ...]:
        images = maps.flatten(0, 2)
        if self._window.checkpoint_activations and torch.is_grad_enabled():
            features: Any = checkpoint(adapter, images, use_reentrant=False, preserve_rng_state=False)
        else:
            features = adapter(images)
        return tuple(x.view(*maps.shape[:3], *x.shape[1:]) for x in features)

    @property
    def _device(self) -> torch.device:
        device: torch.device = self.unet.conv_in.weight.device
        return device

    def _converted(self, x: Tensor) -> Tensor:
        return x.to(self.unet.conv_in.weight)

    def _flags(self, x: Tensor | None) -> Tensor | None:
        return None if x is None else x.to(self._device, torch.bool)


def add_residuals(layout: Sequence[Tensor], points: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """Add the residuals of both adapters, block by block."""
    return tuple(image + point for image, point in zip(layout, points))


def _transformer_blocks(unet: Any) -> list[Any]:
    """Blocks of a UNet that have spatial transformers."""
    blocks = [*unet.down_blocks, unet.mid_block, *unet.up_blocks]
    return [block for block in blocks if getattr(block, "has_cross_attention", False)]
