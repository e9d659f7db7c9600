"""The small network for ``python -m pskel.train``."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...train.clip import Clip
from ...train.config import TrainOptions
from ...train.task import Player
from .augment import Dice
from .config import CELL, SmallConfig
from .draws import Batch, DrawOptions, Frames, Statistics, draw_batch
from .inputs import Maps, cells, ego_numbers, full_planes, token_rays, work_planes
from .losses import Discriminator, answer_loss, guess_errors, image_weights, similarity, texture_errors
from .network import Features, SmallNetwork, Window
from .weights import header, parameters

__all__ = ["LossOptions", "SmallTask", "recipe", "task"]

MEASURED = 200
"""Clips of which statistics are taken."""


@dataclass(frozen=True)
class LossOptions:
    """Weights of the losses."""

    absolute: float = 10.0
    square: float = 100.0
    structure: float = 1.0
    texture: float = 0.0
    adversarial: float = 0.1
    features: float = 2.0
    """Of the decoded images: absolute and squared error, 1 minus the structural similarity, the difference of gradient
    magnitudes, the discriminator, and the errors of its features."""
    adversarial_start: int = 1_000_000_000
    """First step with a discriminator, which is trained from ``adversarial_warmup`` steps before."""
    adversarial_warmup: int = 150
    expected_error: float = 0.4
    """Expected error of the trained denoiser, as a share of the guess's error. A small value makes a network that was trained
    briefly answer with the mean of the possible images rather than with noise."""
    discriminator_rate: float = 4e-4


def recipe(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return how the maps of the network are rendered."""
    return SmallConfig().recipe | dict(options.get("recipe", {}))


def task(options: Mapping[str, Any], train: TrainOptions) -> SmallTask:
    """Create the task. ``options`` are fields of ``SmallConfig``, ``DrawOptions`` and ``LossOptions``, and ``start``: a file of
    weights to start from. Raises ``ValueError`` for others."""
    tables: dict[Any, dict[str, Any]] = {SmallConfig: {}, DrawOptions: {}, LossOptions: {}}
    for key, value in options.items():
        kinds = [kind for kind in tables if key in {each.name for each in fields(kind)}]
        if not kinds and key != "start":
            known = sorted({each.name for kind in tables for each in fields(kind)} | {"start"})
            raise ValueError(f"expected the options {', '.join(known)}, found {key!r}")
        for kind in kinds:
            tables[kind][key] = tuple(value) if isinstance(value, list) else value
    config = SmallConfig.from_json(tables[SmallConfig] | {"recipe": dict(recipe(options))})
    return SmallTask(config, DrawOptions(**tables[DrawOptions]), LossOptions(**tables[LossOptions]), options.get("start"))


class SmallTask:
    """Losses of network and discriminator. The statistics of the data are taken once, and stay."""

    def __init__(self, config: SmallConfig, draws: DrawOptions, losses: LossOptions, start: str | None = None) -> None:
        from .weights import load

        self.config, self._draws, self._losses = config, draws, losses
        self._is_started = start is not None
        self.network = load(start) if start is not None else SmallNetwork(config)
        if self.network.config != config:
            raise ValueError(f"expected weights of this configuration, found {self.network.config.to_json()}: {start}")
        matrices = [each for each in self.network.parameters() if each.dim() > 1]
        vectors = [each for each in self.network.parameters() if each.dim() <= 1]
        groups: list[dict[str, Any]] = [{"params": matrices}, {"params": vectors, "weight_decay": 0.0}]
        self.players = [Player("network", self.network, groups)]
        if losses.adversarial > 0:
            discriminator = Discriminator()
            group = {"params": list(discriminator.parameters()), "lr": losses.discriminator_rate, "betas": (0.5, 0.99),
                     "weight_decay": 0.0, "schedule": "constant"}  # fmt: skip
            first = max(0, losses.adversarial_start - losses.adversarial_warmup)
            self.players.append(Player("discriminator", discriminator, [group], start=first))
        self._images: Tensor | None = None

    @property
    def statistics(self) -> Statistics:
        """Statistics of the data."""
        return Statistics(*(each.cpu() for each in (self.network.means, self.network.scales, self.network.priors)))

    def prepare(self, clips: Iterator[Clip]) -> None:
        """Take the statistics, unless the network started from weights that have some."""
        if self._is_started:
            return
        clean, guess = [], []
        for clip in itertools.islice(clips, MEASURED):
            frames = frames_of(clip, range(len(clip.names)), slice(0, 1))
            clean.append(F.avg_pool2d(frames.images, CELL))
            guess.append(cells(work_planes(frames.maps)))
        colors, guesses = torch.cat(clean).double(), torch.cat(guess).double()
        means, scales = colors.mean((0, 2, 3)), colors.std((0, 2, 3)).clamp(min=1e-3)
        errors = (colors - guesses).square().mean((0, 2, 3)).sqrt() / scales
        self.network.means.copy_(means)
        self.network.scales.copy_(scales)
        self.network.priors.copy_(errors.clamp(min=1e-2) * self._losses.expected_error)

    def draw(self, clips: Sequence[Clip], step: int, seed: int, rank: int) -> tuple[Batch, int]:
        """Return a batch: windows of as many neighboring cameras from all clips; and the step."""
        dice = Dice(torch.Generator().manual_seed(((seed * 1_000_003) + step) * 4099 + rank))
        most = min(len(clip.names) for clip in clips)
        views = most if dice.unit() < self._draws.all_cameras else 1 + dice.below(most)
        windows = []
        for clip in clips:
            first, count = dice.below(len(clip.names)), len(clip.names)
            for number in range(count // views):
                chosen = [(first + number * views + view) % count for view in range(views)]
                windows.append(frames_of(clip, chosen))
        return draw_batch(windows, self.statistics, self._draws, dice), step

    def loss(
        self, player: str, batch: tuple[Batch, int], modules: Mapping[str, nn.Module], device: torch.device
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the loss of the network or of the discriminator."""
        drawn, step = batch
        if player == "discriminator":
            assert self._images is not None
            real = modules["discriminator"](drawn.truth, drawn.planes)[-1].float()
            fake = modules["discriminator"](self._images, drawn.planes)[-1].float()
            loss = F.relu(1 - real).mean() + F.relu(1 + fake).mean()
            return loss, {"discriminator": loss.item()}
        statistics = Statistics(*(each.to(device) for each in self.statistics))
        answer, images = modules["network"](drawn.window, drawn.planes, drawn.places)
        images = images.float()
        self._images = images.detach()
        errors = guess_errors(drawn, statistics, self._losses.expected_error)
        answers = answer_loss(answer, drawn, statistics, errors)
        weights = image_weights(drawn, errors)
        off = (images - drawn.truth) * weights
        absolute, square = off.abs().mean(), off.square().mean()
        structure = ((1 - similarity(images, drawn.truth)) * weights.flatten()).mean()
        texture = (texture_errors(images, drawn.truth) * weights.flatten()).mean()
        errors_of_images = {"absolute": absolute, "square": square, "structure": structure, "texture": texture}
        loss = answers + sum(getattr(self._losses, name) * error for name, error in errors_of_images.items())
        logged = {"answer": answers.item()} | {name: error.item() for name, error in errors_of_images.items()}
        begun = step - self._losses.adversarial_start
        if begun >= 0 and "discriminator" in modules:
            with torch.no_grad():
                real = modules["discriminator"](drawn.truth, drawn.planes)
            fake = modules["discriminator"](images, drawn.planes)
            features = sum((a.float() - b.float()).abs().mean() for a, b in zip(fake[:-1], real[:-1]))
            adversarial = -fake[-1].float().mean()
            share = min(1.0, begun / 200)
            loss = loss + share * (self._losses.adversarial * adversarial + self._losses.features * features)
            logged |= {"features": float(features), "adversarial": adversarial.item()}
        return loss, logged

    def scores(self, clip: Clip, modules: Mapping[str, nn.Module]) -> dict[str, float]:
        """Return the PSNR (dB) of the last frame's images, and of the filled colors."""
        images, filled, truth = self._last_frame(clip, modules)

        def psnr_db(found: Tensor) -> float:
            return float((-10 * (found - truth).square().mean((1, 2, 3)).clamp(min=1e-10).log10()).mean())

        return {"psnr_db": psnr_db(images), "filled_psnr_db": psnr_db(filled)}

    def pictures(self, clip: Clip, modules: Mapping[str, nn.Module]) -> Tensor:
        """Return three rows: filled colors, images, ground truth of the last frame, ``uint8 [3, 3, H, V W]``."""
        rows = [torch.cat(list(row), -1) for row in self._last_frame(clip, modules)]
        return (torch.stack(rows) * 255).round().clamp(0, 255).to(torch.uint8).cpu()

    def _last_frame(self, clip: Clip, modules: Mapping[str, nn.Module]) -> tuple[Tensor, Tensor, Tensor]:
        """Return images, filled colors and ground truth of a clip's last frame, of which nothing is known but conditions."""
        network = modules["network"]
        network = getattr(network, "module", network)
        assert isinstance(network, SmallNetwork)
        device = network.means.device
        views, height, width = len(clip.names), *clip.images.shape[-2:]
        frames = frames_of(clip, range(views))
        maps = Maps(*(each.to(device) for each in frames.maps))
        length = len(frames.action)
        work = work_planes(maps)
        sigmas = torch.full((1, length), 0.999, device=device)
        noise = Dice(torch.Generator().manual_seed(clip.frame)).normal(
            torch.empty(1, length, views, 3, height // CELL, width // CELL)
        )
        rays = token_rays(maps.cameras, height, width).reshape(1, length, views, height // 32, width // 32, -1)
        window = Window(work, noise.to(device), sigmas, rays, ego_numbers(frames.action.to(device))[None])
        answer, features = network.answer(window)
        latents = network.clean(window, answer)[0, -1]
        last = slice((length - 1) * views, None)
        planes = full_planes(Maps(*(each[last] for each in maps)))
        images = network.decoder(planes, Features(*(each[last] for each in features)), latents).float()
        filled = planes[:, :3] / 4 + 0.5
        return images.clamp(0, 1), filled, frames.images[last].to(device)

    def weights(self, modules: Mapping[str, nn.Module]) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Return the file that the program reads."""
        network = modules["network"]
        network = getattr(network, "module", network)
        assert isinstance(network, SmallNetwork)
        return parameters(network), header(network)

    def state(self) -> dict[str, Any]:
        """Return nothing: the statistics are buffers of the network."""
        return {}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore nothing."""


def frames_of(clip: Clip, cameras: Sequence[int], frames: slice = slice(None)) -> Frames:
    """Return the frames of some cameras as numbers."""
    chosen = list(cameras)

    def images(values: Tensor) -> Tensor:
        return values[frames][:, chosen].flatten(0, 1).float() / 255

    bins = clip.bins[frames][:, chosen].flatten(0, 1)[:, None].float()
    last = clip.recipe["bins"]["count"] - 1
    depth = torch.where(bins > 0, bins.clamp(max=last) / last, torch.full_like(bins, -1))
    maps = Maps(images(clip.color), depth, images(clip.boxes), images(clip.map), clip.cameras[frames][:, chosen].flatten(0, 1))
    return Frames(maps, images(clip.images), clip.action[frames])
