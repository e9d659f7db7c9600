"""The network as a denoiser and codec of the loop."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from .._cache import Cache
from .._condition import ConditionMaps, FrameCondition, compute_keys
from .._rig import Rig
from .._windows import as_tensor, expect_finite, expect_window
from ..pas.ids import ids_from_motion
from ..pas.vae import ImageCodec
from .base import expect_base
from .checkpoint import Training, load, read_header
from .conditions import expect_size, point_channels, visible
from .config import HISTORY_LEVEL, LATENT_SCALE
from .network import Conditions, Network, add_residuals
from .schedule import LAST_TIMESTEP, TIMESTEPS, Schedule
from .text import TextEncoder

__all__ = ["Denoiser", "Models"]

_Array = np.ndarray[Any, np.dtype[np.float32]]


@dataclass(frozen=True)
class Models:
    """Network, autoencoder and text encoder on one device."""

    network: Network
    codec: ImageCodec
    text: TextEncoder
    training: Training

    @classmethod
    def load(
        cls,
        weights: str | os.PathLike[str],
        base: str | os.PathLike[str],
        *,
        dtype: torch.dtype = torch.bfloat16,
        device: str | torch.device = "cuda",
    ) -> Models:
        """Read the weights of a training and a folder of Stable Diffusion 1.5.

        Network and text encoder are of type ``dtype``, the autoencoder is in single precision. Raises ``ValueError``,
        which names the file or folder, if they cannot be read or do not fit each other, and ``OSError``.
        """
        config, training = read_header(weights)
        folder = expect_base(base, with_unet=config.trained != "all")
        network = load(weights, folder, dtype=dtype, device=device)
        codec = ImageCodec.load(folder / "vae", config.in_channels, device)
        text = TextEncoder.load(folder, channels=config.cross_attention_dim, dtype=dtype, device=device)
        return cls(network, codec, text, training)


class Denoiser:
    """Predicts noise (or velocities) for the windows of a log, and encodes and decodes its images.

    A ``Denoiser`` is the function of ``pskel.ResetAndRoll`` with ``sampler="ddim"`` and the ``prediction`` of the
    network's configuration; its conditions are ``FrameCondition``. Encoded conditions of ``cached_frames`` frames
    remain on the device, found by their content: calls give the same result, bit for bit, with any number.

    Reference frames are clean in the loop, but slightly noisy in the training: they get noise of ``history_level`` (0
    for none), which depends on their content and ``seed`` alone. Their conditions are marked by ``is_reference``. With
    ``is_causal``, for the strategy ``causal``, all frames but the last are references. Those that the loop has already
    made noisy (``history_noise``) remain as they are.
    """

    def __init__(
        self,
        models: Models,
        rig: Rig,
        *,
        cached_frames: int = 4,
        history_level: int = HISTORY_LEVEL,
        seed: int = 0,
        is_causal: bool = False,
    ) -> None:
        if not 0 <= history_level < TIMESTEPS:
            raise ValueError(f"expected a history level of 0 to {TIMESTEPS - 1}, found {history_level}")
        self.models = models
        self.rig = rig
        self.history_level = history_level
        self.seed = seed
        self.is_causal = is_causal
        self._mask = visible(rig).unsqueeze(0)
        self._sizes = torch.tensor(rig.image_sizes)
        self._schedule = Schedule(models.network.config.zero_snr)
        self._points: Cache[tuple[Tensor, ...]] = Cache(cached_frames)
        self._layouts: Cache[tuple[Tensor, ...]] = Cache(cached_frames)

    def latent_shape(self, size: Sequence[int]) -> tuple[int, int, int, int]:
        """Return the latent shape ``[V, C, h, w]`` for frames with a size (height, width).

        Raises ``ValueError`` for an unsupported size.
        """
        expect_size(size)
        height, width = size
        channels = self.models.network.config.in_channels
        return len(self.rig.cameras), channels, height // LATENT_SCALE, width // LATENT_SCALE

    def __call__(
        self,
        latents: npt.ArrayLike,
        timesteps: npt.ArrayLike,
        sigmas: npt.ArrayLike,
        conditions: Sequence[FrameCondition],
    ) -> _Array:
        """Predict the noise (or velocity) ``float32 [L, V, C, h, w]`` of a noisy window.

        ``timesteps`` ``[L]`` are 0 to 999; ``sigmas`` follow from them and are not used themselves. Raises
        ``ValueError`` for arrays of other shapes, a window of less than 2 frames, and a prediction that is not finite.
        """
        sample, levels = as_tensor(latents), as_tensor(timesteps)
        self._expect_window(sample, levels, conditions)
        sample, levels = self._perturbed(sample, levels, conditions)
        with torch.inference_mode():
            encoded = self._encoded(conditions)
            output = self.models.network(sample[None], levels[None], encoded, self._mask)
            prediction: _Array = output[0].float().cpu().numpy()
        expect_finite(prediction)
        return prediction

    def predict_guided(
        self,
        latents: npt.ArrayLike,
        timesteps: npt.ArrayLike,
        conditions: Sequence[FrameCondition],
        dropped: Sequence[str],
    ) -> tuple[_Array, _Array]:
        """Predict both halves of guidance, with all conditions and without the ``dropped`` parts, one after the other.

        Arguments, results and errors as for a call, and as for ``FrameCondition.without``.
        """
        # Not as one batch: it would round differently, and the images of a window fill a device.
        bare = [condition.without(*dropped) for condition in conditions]
        return self(latents, timesteps, (), conditions), self(latents, timesteps, (), bare)

    def encode(self, images: npt.ArrayLike) -> _Array:
        """Encode RGB images ``[V, 3, H, W]`` of 0 to 1 as latents ``float32 [V, C, H/8, W/8]``."""
        latents: _Array = self.models.codec.encode(as_tensor(images)).contiguous().cpu().numpy()
        return latents

    def decode(self, latents: npt.ArrayLike) -> _Array:
        """Decode latents ``[V, C, h, w]`` to RGB images ``float32 [V, 3, 8 h, 8 w]`` of 0 to 1."""
        images: _Array = self.models.codec.decode(as_tensor(latents)).contiguous().cpu().numpy()
        return images

    def _expect_window(self, sample: Tensor, levels: Tensor, conditions: Sequence[FrameCondition]) -> None:
        if len(conditions) < 2:
            raise ValueError(f"expected at least 2 frames for the motion of the ego, found {len(conditions)}")
        size = conditions[0].layout.array.shape[2:]
        expect_window(sample, levels, conditions, self.latent_shape(size), size)

    def _perturbed(self, sample: Tensor, levels: Tensor, conditions: Sequence[FrameCondition]) -> tuple[Tensor, Tensor]:
        """Add noise to references; returns latents ``[L, ..]`` and the network's levels ``[L]``."""
        timesteps = self._schedule.of_loop(levels.tolist())
        last = len(conditions) - 1
        sample = sample.clone()
        for frame, condition in enumerate(conditions):
            is_reference = condition.is_reference or (self.is_causal and frame < last)
            if not is_reference or levels[frame] > LAST_TIMESTEP:
                continue
            timesteps[frame] = self.history_level
            if self.history_level:
                level = torch.tensor(self.history_level)
                sample[frame] = self._schedule.noisy(sample[frame], self._noise(sample[frame]), level)
        return sample, timesteps

    def _noise(self, latents: Tensor) -> Tensor:
        """Noise for a frame: the same in every call and every process."""
        content = hashlib.blake2b(latents.numpy().tobytes(), digest_size=8, key=str(self.seed).encode()).digest()
        generator = torch.Generator().manual_seed(int.from_bytes(content, "little") >> 1)
        return torch.randn(latents.shape, generator=generator)

    def _encoded(self, conditions: Sequence[FrameCondition]) -> Conditions:
        """Encode the conditions of a window; adapters and text encoder run only for new content."""
        cameras = as_tensor(np.stack([condition.cameras for condition in conditions]))
        action = as_tensor(np.stack([condition.action for condition in conditions]))
        ids = ids_from_motion(cameras, self._sizes, action, self.rig.fps)
        compute_keys(maps for condition in conditions for maps in (condition.points, condition.layout))
        network = self.models.network
        frames = [
            Conditions(
                add_residuals(self._layout(condition.layout), self._point(condition.points)),
                network.encode_text(self.models.text.encode_all(condition.prompts)[None, None]),
                network.encode_view(numbers[None, None]),
            )
            for condition, numbers in zip(conditions, ids)
        ]
        return Conditions.concatenate(frames, dim=1)

    def _layout(self, maps: ConditionMaps) -> tuple[Tensor, ...]:
        return self._layouts.get(maps.key, lambda: self.models.network.encode_layout(_frame(maps)))

    def _point(self, maps: ConditionMaps) -> tuple[Tensor, ...]:
        network = self.models.network
        return self._points.get(maps.key, lambda: network.encode_points(point_channels(_frame(maps), network.config)))


def _frame(maps: ConditionMaps) -> Tensor:
    """Maps ``[1, 1, V, C, H, W]``."""
    return torch.tensor(maps.array)[None, None]
