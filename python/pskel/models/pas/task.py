"""The network for ``python -m pskel.train``: network ``pas`` (docs/src/guide/training.md)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from ...train.clip import Clip
from ...train.config import TrainOptions
from ...train.errors import DataError
from ...train.task import Player
from .._command import silence
from .._rig import CameraNumbers, inverse
from .base import expect_base
from .checkpoint import as_header, load_start
from .config import Config
from .network import Network
from .text import TextEncoder
from .training.collate import collate, rig_of
from .training.draws import Draws, generator_of
from .training.modes import TrainMode, merged, prepare, trained_weights
from .training.module import TrainedNetwork
from .training.options import TaskOptions, parse
from .training.presets import PRESETS
from .training.sample import sample
from .training.step import Batch, Inputs, StepOptions, Targets, Texts, loss_of, noisy_inputs
from .vae import LATENT_SCALE, ImageCodec

__all__ = ["PasTask", "recipe", "task"]

_NETWORK = "network"
_PREFIX = "network."
_SCORED_DRAWS = 4
"""Draws of which the loss of a held-out clip is the mean."""


class Drawn(NamedTuple):
    """A batch with its random numbers."""

    batch: Batch
    draws: Draws


def recipe(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return how the maps of the network are rendered."""
    name = options.get("preset", TaskOptions.preset)
    if name not in PRESETS:
        raise ValueError(f"expected preset of {', '.join(PRESETS)}, found {name!r}")
    return PRESETS[name].recipe


def task(options: Mapping[str, Any], train: TrainOptions) -> PasTask:
    """Create the task. Raises ``ValueError`` for unknown options, and for files that do not fit, which it names."""
    silence()
    return PasTask(*parse(options), train)


class PasTask:
    """Trains the network on clips. Autoencoder and text encoders are frozen; the first loss moves them to the GPU."""

    def __init__(self, options: TaskOptions, step: StepOptions, train: TrainOptions) -> None:
        self.options, self.step = options, step
        self.mode = TrainMode.parse(options.train)
        self.config = Config.read(options.config) if options.config else Config()
        self.camera_numbers: CameraNumbers = options.numbers
        folder = expect_base(options.base)
        network = load_start(options.weights, self.config) if options.weights else Network(self.config)
        trained, self._dtype = _dtypes(train)
        prepare(network, self.mode, with_points=step.with_points, trained_dtype=trained, frozen_dtype=self._dtype)
        network.checkpoint_activations = options.checkpointing
        self.network = TrainedNetwork(network)
        self._codec = ImageCodec.load(folder / "vae", self.config.in_channels)
        self._codec.vae.requires_grad_(False)
        self._text = TextEncoder.load(
            folder,
            channels=self.config.joint_attention_dim,
            pooled_channels=self.config.pooled_projection_dim,
            dtype=self._dtype,
        )
        self._text.stays_on_device = options.text_on_device
        self._captions: dict[str, tuple[Tensor, Tensor]] = {}

    @property
    def players(self) -> Sequence[Player]:
        """The network."""
        trained = [parameter for parameter in self.network.parameters() if parameter.requires_grad]
        return [Player(_NETWORK, self.network, [{"params": trained}])]

    def prepare(self, clips: Iterator[Clip]) -> None:
        """Check a clip. Raises ``DataError``."""
        self._collated([next(clips)])

    def draw(self, clips: Sequence[Clip], step: int, seed: int, rank: int) -> Drawn:
        """Join clips, and draw the random numbers of each by itself. Raises ``DataError`` for clips that do not fit.

        One batch of two clips has the same numbers as two batches of one.
        """
        batch = self._collated(clips)
        first = rank * len(clips)
        parts = [self._draws(batch, seed, step, first + number) for number in range(len(clips))]
        return Drawn(batch, Draws.concatenate(parts))

    def loss(
        self, player: str, batch: Drawn, modules: Mapping[str, nn.Module], device: torch.device
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the loss, and the mean noise level."""
        inputs, targets = self._inputs(batch, device)
        return loss_of(modules[player](inputs), targets), {"sigma": float(targets.sigma.mean())}

    def pictures(self, clip: Clip, modules: Mapping[str, nn.Module]) -> Tensor:
        """Return color map, boxes, generated and recorded images of the last frame, cameras side by side."""
        generated = (self._generated(clip, modules[_NETWORK])[-1] * 255.0).round().to(torch.uint8)
        rows = [clip.color[-1], clip.boxes[-1], generated, clip.images[-1]]
        return torch.stack([torch.cat(list(row), dim=-1) for row in rows])

    def scores(self, clip: Clip, modules: Mapping[str, nn.Module]) -> dict[str, float]:
        """Return the loss with fixed draws, and the peak signal-to-noise ratio of the clip, generated from noise."""
        network = modules[_NETWORK]
        device = next(network.parameters()).device
        batch = self._collated([clip])
        losses = []
        for number in range(_SCORED_DRAWS):
            draws = self._draws(batch, "scores", clip.log, clip.frame, number)
            inputs, targets = self._inputs(Drawn(batch, draws), device)
            losses.append(loss_of(network(inputs), targets))
        error = (self._generated(clip, network) - clip.images.float() / 255.0).square().mean()
        return {"loss": float(torch.stack(losses).mean()), "psnr_db": float(-10.0 * error.clamp(min=1e-10).log10())}

    def weights(self, modules: Mapping[str, nn.Module]) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Return the tensors of a checkpoint, as ``load`` reads it, or the trained ones alone, and the header."""
        state = {name.removeprefix(_PREFIX): tensor for name, tensor in modules[_NETWORK].state_dict().items()}
        if self.options.export == "trained":
            tensors = trained_weights(state, self.mode)
        else:
            tensors = merged({name: _whole(tensor) for name, tensor in state.items()}) if self.mode.lora_rank else state
        about = {
            "config": asdict(self.config),
            "camera_numbers": self.camera_numbers,
            "depth": self.step.depth,
            "preset": self.options.preset,
            "export": self.options.export,
            "lora_rank": self.mode.lora_rank,
        }
        return tensors, as_header(about)

    def state(self) -> dict[str, Any]:
        """Return nothing: all state is in the module."""
        return {}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore ``state``."""

    def _collated(self, clips: Sequence[Clip]) -> Batch:
        try:
            return collate(clips, self.config, self.camera_numbers)
        except ValueError as error:
            raise DataError(str(error)) from error

    def _draws(self, batch: Batch, *key: int | str) -> Draws:
        """Draw the numbers of one clip as large as ``batch``."""
        _, frames, views, _, height, width = batch.images.shape
        latents = frames, views, self.config.in_channels, height // LATENT_SCALE, width // LATENT_SCALE
        return Draws.sample(generator_of(*key), 1, latents)

    def _inputs(self, drawn: Drawn, device: torch.device) -> tuple[Inputs, Targets]:
        self._move(device)
        batch, draws = drawn.batch.to(device), drawn.draws.to(device)
        latents = self._codec.sample(batch.images, draws.posterior_noise, self.options.image_batch)
        return noisy_inputs(batch, self._texts(batch, device), latents, draws, self.step)

    def _texts(self, batch: Batch, device: torch.device) -> Texts:
        """Encode the captions of a batch that are not cached."""
        wanted = [text for text in batch.texts if text not in self._captions]
        if wanted:
            self._captions.update(zip(wanted, map(_copied, self._text.encode_all(wanted))))
        found = [self._captions[text] for text in batch.texts]
        for oldest in list(self._captions)[: max(0, len(self._captions) - self.options.cached_captions)]:
            del self._captions[oldest]
        tokens, pooled = zip(*found)
        return Texts(torch.stack(tokens).to(device), torch.stack(pooled).to(device))

    def _generated(self, clip: Clip, network: nn.Module) -> Tensor:
        """Generate a clip from noise; returns images ``float32 [T, V, 3, H, W]`` on the CPU, cameras as in the clip."""
        device = next(network.parameters()).device
        self._move(device)
        batch = self._collated([clip]).to(device)
        noise = self._draws(batch, "pictures", clip.log, clip.frame).noise.to(device)
        texts, options = self._texts(batch, device), self.options
        latents = sample(
            network, batch, texts, noise, self.step, steps=options.infer_steps, guidance=options.guidance
        )
        parts = torch.split(latents[0].flatten(0, 1), self.options.image_batch)
        images = torch.cat([self._codec.decode(part).cpu() for part in parts])
        return images.view(clip.images.shape)[:, inverse(rig_of(clip).order)]

    def _move(self, device: torch.device) -> None:
        """Move the frozen parts to a device."""
        if self._codec.device != device:
            self._codec = ImageCodec(self._codec.vae, device)
            self._text.device = device


def _dtypes(train: TrainOptions) -> tuple[torch.dtype, torch.dtype]:
    """Types of trained and frozen parameters; with moments of 8 bits, the optimizer has weights in ``float32``."""
    if train.precision == "f32":
        return torch.float32, torch.float32
    if train.optimizer != "adamw8bit":
        return torch.float32, torch.bfloat16
    if train.ema:
        raise ValueError("train.ema needs weights in float32: use train.optimizer adamw, or no average")
    return torch.bfloat16, torch.bfloat16


def _copied(encoded: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Copy to main memory; the originals are inference tensors, which a training cannot use."""
    tokens, pooled = (tensor.cpu().clone() for tensor in encoded)
    return tokens, pooled


def _whole(tensor: Tensor) -> Tensor:
    """Copy to main memory; of a sharded tensor the whole, for which all processes ask."""
    whole: Tensor = tensor.full_tensor() if hasattr(tensor, "full_tensor") else tensor
    return whole.cpu()
