"""The network as a denoiser and codec of the loop."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from .._cache import Cache
from .._condition import POINT_CHANNELS, ConditionMaps, FrameCondition, compute_keys
from .._rig import CameraNumbers, Rig, inverse
from .._windows import as_tensor, expect_finite, expect_window
from .base import expect_base
from .checkpoint import load
from .config import Config
from .ids import ids_from_motion
from .network import Conditions, Network, add_residuals
from .text import TextEncoder
from .vae import LATENT_SCALE, ImageCodec

__all__ = ["Denoiser", "Models"]

_Array = np.ndarray[Any, np.dtype[np.float32]]
_MAP_CHANNELS = 20
_CACHED_TEXTS = 64


@dataclass(frozen=True)
class Models:
    """Network, autoencoder and text encoders on one device."""

    network: Network
    codec: ImageCodec
    text: TextEncoder

    @classmethod
    def load(
        cls,
        weights: str | os.PathLike[str],
        base: str | os.PathLike[str],
        config: Config = Config(),
        *,
        dtype: torch.dtype = torch.bfloat16,
        device: str | torch.device = "cuda",
    ) -> Models:
        """Read a checkpoint and a folder of Stable Diffusion 3.5.

        Network and text encoders are of type ``dtype``, the autoencoder is in single precision. Raises ``ValueError``, which
        names the file or folder, if they cannot be read or do not fit each other, and ``OSError``.
        """
        folder = expect_base(base)
        network = load(weights, config, dtype=dtype, device=device)
        codec = ImageCodec.load(folder / "vae", config.in_channels, device)
        channels, pooled = config.joint_attention_dim, config.pooled_projection_dim
        text = TextEncoder.load(folder, channels=channels, pooled_channels=pooled, dtype=dtype, device=device)
        return cls(network, codec, text)


class Denoiser:
    """Predicts velocities for the windows of a log, and encodes and decodes its images.

    A ``Denoiser`` is the function of ``pskel.ResetAndRoll``; its conditions are ``FrameCondition``. Cameras are in the order
    of ``rig``. Encoded conditions of ``cached_frames`` frames remain on the device, found by their content: calls give the
    same result, bit for bit, with any number. ``camera_numbers`` must match the training of the network; without it, they
    match the published checkpoint for these cameras.
    """

    def __init__(
        self, models: Models, rig: Rig, *, cached_frames: int = 24, camera_numbers: CameraNumbers | None = None
    ) -> None:
        self.models = models
        self.rig = rig
        self.camera_numbers: CameraNumbers = rig.camera_numbers if camera_numbers is None else camera_numbers
        self._order = rig.order
        self._inverse = inverse(self._order)
        self._mask = rig.mask.unsqueeze(0)
        self._sizes = torch.tensor(rig.image_sizes)[self._order]
        self._points: Cache[tuple[Tensor, ...]] = Cache(cached_frames)
        self._layouts: Cache[tuple[Tensor, ...]] = Cache(cached_frames)
        self._texts: Cache[tuple[Tensor, Tensor]] = Cache(_CACHED_TEXTS)

    def latent_shape(self, size: Sequence[int]) -> tuple[int, int, int, int]:
        """Return the latent shape ``[V, C, h, w]`` for frames with a size (height, width).

        Raises ``ValueError`` for an unsupported size.
        """
        config = self.models.network.config
        unit, most = LATENT_SCALE * config.patch_size, LATENT_SCALE * config.patch_size * config.pos_embed_max_size
        height, width = size
        if height % unit or width % unit or not 0 < min(size) <= max(size) <= most:
            raise ValueError(f"expected height and width in multiples of {unit} up to {most}, found {height}x{width}")
        return len(self.rig.cameras), config.in_channels, height // LATENT_SCALE, width // LATENT_SCALE

    def __call__(
        self,
        latents: npt.ArrayLike,
        timesteps: npt.ArrayLike,
        sigmas: npt.ArrayLike,
        conditions: Sequence[FrameCondition],
    ) -> _Array:
        """Predict the velocity (noise less latents) ``float32 [L, V, C, h, w]`` for a noisy window.

        ``timesteps`` ``[L]`` are 1000 times the ``sigmas`` of flow matching, which are not used themselves. Raises
        ``ValueError`` for arrays of other shapes, a window of less than 2 frames, and a prediction that is not finite.
        """
        velocity: _Array = self._predict(latents, timesteps, [conditions])[0]
        return velocity

    def predict_guided(
        self,
        latents: npt.ArrayLike,
        timesteps: npt.ArrayLike,
        conditions: Sequence[FrameCondition],
        dropped: Sequence[str],
    ) -> tuple[_Array, _Array]:
        """Predict both halves of guidance, with all conditions and without the ``dropped`` parts, as two clips of one call.

        Arguments, results and errors as for a call, and as for ``FrameCondition.without``.
        """
        bare = [condition.without(*dropped) for condition in conditions]
        conditional, unconditional = self._predict(latents, timesteps, [conditions, bare])
        return conditional, unconditional

    def _predict(
        self, latents: npt.ArrayLike, timesteps: npt.ArrayLike, clips: Sequence[Sequence[FrameCondition]]
    ) -> _Array:
        """Predict velocities ``[B, L, V, C, h, w]`` of one window, for the conditions of B ``clips``."""
        sample, levels = as_tensor(latents), as_tensor(timesteps)
        for conditions in clips:
            self._expect_window(sample, levels, conditions)
        count = len(clips)
        with torch.inference_mode():
            encoded = Conditions.concatenate([self._encoded(conditions) for conditions in clips], dim=0)
            samples = sample[:, self._order].expand(count, *sample.shape)
            timestep = levels[None, :, None].expand(count, *sample.shape[:2])
            output = self.models.network(samples, timestep, encoded, self._mask.expand(count, -1, -1))
            velocity: _Array = output[:, :, self._inverse].float().cpu().numpy()
        expect_finite(velocity)
        return velocity

    def encode(self, images: npt.ArrayLike) -> _Array:
        """Encode RGB images ``[V, 3, H, W]`` of 0 to 1 as latents ``float32 [V, C, H/8, W/8]``."""
        latents: _Array = self.models.codec.encode(as_tensor(images)).contiguous().cpu().numpy()
        return latents

    def decode(self, latents: npt.ArrayLike) -> _Array:
        """Decode latents ``[V, C, h, w]`` to RGB images ``float32 [V, 3, 8 h, 8 w]`` of 0 to 1."""
        images: _Array = self.models.codec.decode(as_tensor(latents)).contiguous().cpu().numpy()
        return images

    def _expect_window(self, sample: Tensor, levels: Tensor, conditions: Sequence[FrameCondition]) -> None:
        if not conditions:
            raise ValueError("expected at least 2 frames for the motion of the ego, found 0")
        size = conditions[0].layout.array.shape[2:]
        expect_window(sample, levels, conditions, self.latent_shape(size), size)

    def _encoded(self, conditions: Sequence[FrameCondition]) -> Conditions:
        """Encode the conditions of a window; adapters and text encoders run only for new content."""
        network = self.models.network
        cameras = as_tensor(np.stack([condition.cameras for condition in conditions]))[:, self._order]
        action = as_tensor(np.stack([condition.action for condition in conditions]))
        ids = ids_from_motion(cameras, self._sizes, action, self.rig.fps, camera_numbers=self.camera_numbers)
        compute_keys(maps for condition in conditions for maps in (condition.points, condition.layout))
        frames = [
            Conditions(
                add_residuals(self._layout(condition.layout), self._point(condition.points)),
                *self._text(condition.prompts),
                network.encode_view(numbers[None, None]),
            )
            for condition, numbers in zip(conditions, ids)
        ]
        return Conditions.concatenate(frames, dim=1)

    def _layout(self, maps: ConditionMaps) -> tuple[Tensor, ...]:
        return self._layouts.get(maps.key, lambda: self.models.network.encode_layout(self._frame(maps)))

    def _point(self, maps: ConditionMaps) -> tuple[Tensor, ...]:
        def encode() -> tuple[Tensor, ...]:
            frame = self._frame(maps)
            # In place of the sines and cosines of the depth, the checkpoints were trained with zeros.
            waves = frame.new_zeros((*frame.shape[:3], _MAP_CHANNELS - POINT_CHANNELS, *frame.shape[4:]))
            return self.models.network.encode_points(torch.cat([frame, waves], dim=3))

        return self._points.get(maps.key, encode)

    def _text(self, prompts: Sequence[str]) -> tuple[Tensor, Tensor]:
        """Encode the prompts of the cameras, in the order of the rig."""
        if len(set(prompts)) == 1:
            return self._prompt(prompts[0])
        parts = [self._prompt(prompts[camera]) for camera in self._order]
        text, pooled = (torch.cat([tensor[:, :, :1] for tensor in tensors], dim=2) for tensors in zip(*parts))
        return text, pooled

    def _prompt(self, prompt: str) -> tuple[Tensor, Tensor]:
        """Encode a prompt for all cameras."""

        def encode() -> tuple[Tensor, Tensor]:
            leading = 1, 1, len(self.rig.cameras)
            tokens, pooled = self.models.text(prompt)
            return self.models.network.encode_text(tokens.expand(*leading, -1, -1), pooled.expand(*leading, -1))

        return self._texts.get(prompt, encode)

    def _frame(self, maps: ConditionMaps) -> Tensor:
        """Maps ``[1, 1, V, C, H, W]`` in the order of the network, on its device."""
        return torch.tensor(maps.array[self._order], device=self.models.codec.device)[None, None]
