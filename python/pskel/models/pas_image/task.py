"""The network for ``python -m pskel.train``: network ``pas-image`` (docs/src/guide/training.md)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from ...train.clip import Clip
from ...train.config import TrainOptions
from ...train.errors import DataError
from ...train.task import Player
from .._command import silence
from ..pas.training.draws import generator_of
from ..pas.vae import ImageCodec
from .base import base_config, expect_base
from .checkpoint import Training, create, header, saved_tensors
from .conditions import Batch, collate
from .config import HISTORY_LEVEL, LATENT_SCALE, Config
from .presets import PRESETS
from .schedule import TIMESTEPS, Schedule, inference_timesteps
from .step import DROPPABLE, Draws, StepOptions, conditioned, errors_of, loss_of, noisy_inputs
from .text import TextEncoder

__all__ = ["ImageTask", "TaskOptions", "recipe", "task"]

BIN_SCALES = ("linear", "log")

_NETWORK = "network"
_GUIDED = frozenset({"text", "boxes", "map", "action"})
"""Parts that the half of guidance without conditions is without."""
_SCORED_STEPS = 4
"""Random draws of which the loss of a held-out clip is the mean."""


@dataclass(frozen=True)
class TaskOptions:
    """The table ``[pas-image]``, together with the fields of ``StepOptions``."""

    base: str
    """Folder of Stable Diffusion 1.5: unet, vae, text_encoder, tokenizer."""
    train: str = "all"
    """``all``, ``adapters``, or ``lora:R`` with the rank R."""
    recipe: str = "pas-image-nuscenes"
    """Name in ``PRESETS``, unless ``[data.recipe]`` says how maps are rendered."""
    bin_scale: str = "linear"
    """Scale of the depth bins: ``linear``, or ``log`` for finer bins near the camera."""
    prediction: str = "epsilon"
    zero_snr: bool = False
    depth: str = "continuous"
    """See ``Config``."""
    checkpointing: bool = False
    """Whether blocks are computed again in the backward pass, which saves memory and takes a third more time."""
    image_batch: int = 12
    """Images that the autoencoder encodes at a time."""
    infer_steps: int = 20
    guidance: float = 2.0
    history_level: int = HISTORY_LEVEL
    """Inference steps, guidance and noise of the previous frame in validations."""

    def __post_init__(self) -> None:
        recipe({"recipe": self.recipe, "bin_scale": self.bin_scale})
        inference_timesteps(self.infer_steps)
        if self.image_batch < 1:
            raise ValueError(f"expected image_batch of at least 1, found {self.image_batch}")
        if not 0 <= self.history_level < TIMESTEPS:
            raise ValueError(f"expected history_level of 0 to {TIMESTEPS - 1}, found {self.history_level}")


class Drawn(NamedTuple):
    """A batch with its random numbers."""

    batch: Batch
    draws: Draws


def recipe(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return how the maps of the network are rendered."""
    name = options.get("recipe", TaskOptions.recipe)
    if name not in PRESETS:
        raise ValueError(f"expected recipe of {', '.join(PRESETS)}, found {name!r}")
    scale = options.get("bin_scale", TaskOptions.bin_scale)
    if scale not in BIN_SCALES:
        raise ValueError(f"expected bin_scale of {', '.join(BIN_SCALES)}, found {scale!r}")
    values = dict(PRESETS[name].recipe)
    return values if scale == TaskOptions.bin_scale else {**values, "bins": {**values["bins"], "scale": scale}}


def task(options: Mapping[str, Any], train: TrainOptions) -> ImageTask:
    """Create the task. Raises ``ValueError`` for unknown options, and for a folder that is not Stable Diffusion 1.5."""
    kinds = (TaskOptions, StepOptions)
    known = {field.name: (kind, field.default) for kind in kinds for field in fields(kind)}
    if unknown := sorted(set(options) - set(known)):
        raise ValueError(f"expected the options {', '.join(known)}, found {unknown[0]!r}")
    if "base" not in options:
        raise ValueError("expected base, a folder of Stable Diffusion 1.5, found none")
    values: dict[Any, dict[str, Any]] = {kind: {} for kind in kinds}
    for name, value in options.items():
        kind, default = known[name]
        values[kind][name] = _converted(name, value, "" if name == "base" else default)
    return ImageTask(TaskOptions(**values[TaskOptions]), StepOptions(**values[StepOptions]))


class ImageTask:
    """Trains the network. Autoencoder and text encoder are frozen, and on the device from the first loss on."""

    def __init__(self, options: TaskOptions, step: StepOptions = StepOptions()) -> None:
        silence()
        self.options, self.step = options, step
        folder = expect_base(options.base, with_unet=True)
        self.config = _config(base_config(folder), options)
        self.schedule = Schedule(self.config.zero_snr)
        self.network = create(self.config, folder)
        if options.checkpointing:
            self.network.enable_checkpointing()
        self.training: Training | None = None
        self._folder = folder
        self._codec = ImageCodec.load(folder / "vae", self.config.in_channels)
        self._codec.vae.requires_grad_(False)
        self._text = TextEncoder.load(folder, channels=self.config.cross_attention_dim)

    @property
    def players(self) -> Sequence[Player]:
        """The network."""
        trained = [parameter for parameter in self.network.parameters() if parameter.requires_grad]
        return [Player(_NETWORK, self.network, [{"params": trained}])]

    def prepare(self, clips: Iterator[Clip]) -> None:
        """Check a clip, and note what the network is trained with. Raises ``DataError``."""
        clip = next(clips)
        _collated([clip], self.config)
        frames, _, _, height, width = clip.images.shape
        self.training = Training(frames, (height, width), clip.hz)

    def draw(self, clips: Sequence[Clip], step: int, seed: int, rank: int) -> Drawn:
        """Join clips, and draw all random numbers of the step. Raises ``DataError`` for clips that do not fit."""
        batch = _collated(clips, self.config)
        return Drawn(batch, self._draws(batch, seed, step, rank))

    def loss(
        self, player: str, batch: Drawn, modules: Mapping[str, nn.Module], device: torch.device
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the loss, and its parts by the kind of clips."""
        self._move(device)
        inputs, targets = self._inputs(batch.batch.to(device), batch.draws.to(device))
        errors = errors_of(modules[player](inputs), targets)
        is_free = targets.is_counted[:, 0]
        kinds = {"after_previous": errors[~is_free][:, -1:], "free": errors[is_free]}
        numbers = {name: float(values.detach().mean()) for name, values in kinds.items() if values.numel()}
        return loss_of(errors, targets), numbers

    def pictures(self, clip: Clip, modules: Mapping[str, nn.Module]) -> Tensor:
        """Return color map, boxes, generated and recorded images of the last frame, cameras side by side."""
        generated = (self._generated(clip, modules[_NETWORK]) * 255.0).round().to(torch.uint8)
        rows = [clip.color[-1], clip.boxes[-1], generated, clip.images[-1]]
        return torch.stack([torch.cat(list(row), dim=-1) for row in rows])

    def scores(self, clip: Clip, modules: Mapping[str, nn.Module]) -> dict[str, float]:
        """Return the loss with fixed draws, and the PSNR of the last frame, generated from the others."""
        network = modules[_NETWORK]
        device = next(network.parameters()).device
        self._move(device)
        batch = _collated([clip], self.config).to(device)
        losses = []
        for number in range(_SCORED_STEPS):
            draws = self._draws(batch, "scores", clip.log, clip.frame, number).to(device)
            inputs, targets = self._inputs(batch, draws)
            losses.append(loss_of(errors_of(network(inputs), targets), targets))
        error = (self._generated(clip, network) - clip.images[-1].float() / 255.0).square().mean()
        return {"loss": float(torch.stack(losses).mean()), "psnr_db": float(-10.0 * error.clamp(min=1e-10).log10())}

    def weights(self, modules: Mapping[str, nn.Module]) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Return the trained tensors, and the header, as ``load`` reads them."""
        if self.training is None:
            raise RuntimeError("expected a call of prepare or load_state before weights, found none")
        return saved_tensors(modules[_NETWORK].state_dict(), self.config), header(self.config, self.training)

    def state(self) -> dict[str, Any]:
        """Return what the network is trained with."""
        return {"training": None if self.training is None else tuple(self.training)}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore ``state``."""
        values = state["training"]
        self.training = None if values is None else Training(values[0], tuple(values[1]), values[2])

    def _draws(self, batch: Batch, *key: int | str) -> Draws:
        clips, frames, views, _, height, width = batch.images.shape
        latents = frames, views, self.config.in_channels, height // LATENT_SCALE, width // LATENT_SCALE
        return Draws.sample(generator_of(*key), clips, latents)

    def _inputs(self, batch: Batch, draws: Draws) -> tuple[Any, Any]:
        latents = self._latents(batch.images, draws.posterior_noise)
        return noisy_inputs(batch, self._tokens(batch), latents, draws, self.schedule, self.config, self.step)

    def _latents(self, images: Tensor, noise: Tensor) -> Tensor:
        """Sample the posterior of images ``uint8 [B, T, V, 3, H, W]``: latents ``float32 [B, T, V, C, h, w]``."""
        parts = torch.split(images.flatten(0, 2), self.options.image_batch)
        moments = [self._codec.posterior(part.float() / 255.0) for part in parts]
        mean, std = (torch.cat(values).view(noise.shape) for values in zip(*moments))
        return self._codec.scaled(mean + std * noise)

    def _tokens(self, batch: Batch) -> Tensor:
        return self._text.encode_all(batch.texts).to(batch.images.device)

    def _generated(self, clip: Clip, network: nn.Module) -> Tensor:
        """Generate the last frame from the recorded ones; returns images ``float32 [V, 3, H, W]`` in main memory."""
        device = next(network.parameters()).device
        self._move(device)
        batch = _collated([clip], self.config).to(device)
        draws = self._draws(batch, "pictures", clip.log, clip.frame).to(device)
        tokens, options = self._tokens(batch), self.options
        previous = torch.full(draws.level.shape, options.history_level, device=device)
        sample = self._latents(batch.images, torch.zeros_like(draws.posterior_noise))
        if options.history_level:
            sample = self.schedule.noisy(sample, draws.noise, previous)
        sample[:, -1] = draws.noise[:, -1]
        never = torch.zeros(1, dtype=torch.bool, device=device)
        halves = [
            dict.fromkeys(DROPPABLE, never),
            {part: never if part not in _GUIDED else ~never for part in DROPPABLE},
        ]
        levels = inference_timesteps(options.infer_steps, self.config.zero_snr)
        for level, after in zip(levels, [*levels[1:], 0]):
            timesteps = previous.clone()
            timesteps[:, -1] = level
            with_all, without = (
                network(conditioned(batch, tokens, sample, timesteps, half, self.config)).float() for half in halves
            )
            output = without + options.guidance * (with_all - without)
            step = (torch.full_like(timesteps[:, -1:], t) for t in (level, after))
            sample[:, -1:] = self.schedule.step(self.config.prediction, sample[:, -1:], output[:, -1:], *step)
        return self._codec.decode(sample[0, -1]).cpu()

    def _move(self, device: torch.device) -> None:
        """Move the frozen parts to a device."""
        if self._codec.device != device:
            self._codec = ImageCodec(self._codec.vae, device)
            self._text.to(device)


def _config(base: Config, options: TaskOptions) -> Config:
    """Sizes of a base with the rules of the options."""
    kind, _, rank = options.train.partition(":")
    if kind not in ("all", "adapters", "lora") or (kind == "lora") != bool(rank) or (rank and not rank.isdecimal()):
        raise ValueError(f"expected train of all, adapters or lora:R with a rank R, found {options.train!r}")
    rules: dict[str, Any] = {"prediction": options.prediction, "depth": options.depth, "trained": kind}
    return replace(base, **rules, zero_snr=options.zero_snr, lora_rank=int(rank or 0))


def _collated(clips: Sequence[Clip], config: Config) -> Batch:
    try:
        return collate(clips, config)
    except ValueError as error:
        raise DataError(str(error)) from error


def _converted(name: str, value: Any, default: Any) -> Any:
    """Check the type of an option by its default."""
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if name == "base" and isinstance(value, Path):
        return str(value)
    if type(value) is not type(default):
        raise ValueError(f"expected {name} of type {type(default).__name__}, found {value!r}")
    return value
