"""The training step: noise levels, errors, losses."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .augment import Dice, augmented, erring
from .config import CELL
from .inputs import NO_ACTION, NO_COLOR, Maps, cells, ego_numbers, full_planes, token_rays, work_planes
from .levels import SIGMA_MIN
from .network import Features, SmallNetwork


class StepOptions(NamedTuple):
    """Options of the training step."""

    drop_layout: float = 0.1
    drop_action: float = 0.1
    drop_color: float = 0.15
    drop_depth: float = 0.15
    drop_all: float = 0.04
    expected_error: float = 0.4
    """Expected error of the trained denoiser, as a share of the guess's error. A small value makes a network that was trained
    briefly answer with the mean of the possible images rather than with noise."""
    infer_steps: int = 8
    shift: float = 3.0
    staircase: float = 0.5
    """Share of windows with the noise levels of a roll, after some finished frames; others have independent levels."""
    history: float = 0.5
    """Share of the other windows that begin with some finished frames."""
    augment: float = 0.9
    errors: float = 0.8
    """Share of windows whose frames have errors like generated ones."""
    crop: tuple[int, int] = (128, 224)
    crops: int = 2
    """Crops of each decoded image."""
    absolute: float = 10.0
    square: float = 100.0
    adversarial: float = 0.0
    features: float = 1.0
    """Weights of the losses of images: absolute and squared error, discriminator, and its features."""


class Window(NamedTuple):
    """Frames of some cameras: maps and images ``[L V, ..]``, ego motion ``[L, 3]``."""

    maps: Maps
    images: Tensor
    action: Tensor


def sigmas_of(steps: int, shift: float) -> Tensor:
    """Return the noise levels of inference steps, as diffusers' ``FlowMatchEulerDiscreteScheduler``."""

    def shifted(sigma: Tensor) -> Tensor:
        return shift * sigma / (1 + (shift - 1) * sigma)

    last = shifted(torch.tensor(1e-3, dtype=torch.float64))
    return shifted(torch.lerp(torch.ones((), dtype=torch.float64), last, torch.linspace(0, 1, steps, dtype=torch.float64))).float()


def draw_levels(options: StepOptions, frames: int, dice: Dice) -> tuple[int, Tensor]:
    """Return the number of finished frames, and the noise level of each frame."""
    table = sigmas_of(options.infer_steps, options.shift)
    if dice.unit() < options.staircase:
        per_roll = options.infer_steps // frames
        call = options.infer_steps - per_roll + dice.below(per_roll)
        finished = dice.below(frames)
        places = [call - max(0, frame - finished) * per_roll for frame in range(frames)]
        levels = [table[-1] if frame < finished else table[place] for frame, place in enumerate(places)]
        return finished, torch.stack(levels)
    finished = dice.below(frames) if dice.unit() < options.history else 0
    time = dice.uniform(frames)
    levels = (options.shift * time / (1 + (options.shift - 1) * time)).clamp(min=SIGMA_MIN)
    levels[:finished] = table[-1]
    return finished, levels


def dropped(window: Window, options: StepOptions, dice: Dice) -> Window:
    """Drop conditions at random, for all frames and cameras alike."""
    everything = dice.unit() < options.drop_all
    layout, action, color, depth = (
        dice.unit() < chance or everything
        for chance in (options.drop_layout, options.drop_action, options.drop_color, options.drop_depth)
    )
    maps = window.maps
    if layout:
        maps = maps._replace(boxes=torch.full_like(maps.boxes, NO_COLOR), map=torch.full_like(maps.map, NO_COLOR))
    if color:
        maps = maps._replace(color=torch.full_like(maps.color, NO_COLOR))
    if depth:
        maps = maps._replace(depth=torch.full_like(maps.depth, -1))
    return window._replace(maps=maps, action=torch.full_like(window.action, NO_ACTION) if action else window.action)


class Prepared(NamedTuple):
    """A batch: B windows of L frames and V cameras."""

    work: Tensor
    """``[B L V, 16, H/4, W/4]``."""
    guess: Tensor
    """Latents of the filled color, ``[B, L, V, 3, h, w]``."""
    clean: Tensor
    noise: Tensor
    noisy: Tensor
    sigmas: Tensor
    """``[B, L]``."""
    counts: Tensor
    """Whether a frame counts in the loss, ``[B, L]``."""
    rays: Tensor
    ego: Tensor
    planes: Tensor
    """Crops of conditions and images to decode, ``[K, .., 128, 224]``."""
    truth: Tensor
    places: Tensor
    """Image, top and left of each crop, ``[K, 3]``, in 16x16 pixels."""


def prepare(network: SmallNetwork, windows: list[Window], views: int, options: StepOptions, dice: Dice) -> Prepared:
    """Return a batch of augmented windows with noise."""
    frames = len(windows[0].action)
    rows, crops = [], []
    for number, window in enumerate(windows):
        maps, images, action = augmented(*window, views, options.augment, dice)
        window = dropped(Window(maps, images, action), options, dice)
        finished, sigmas = draw_levels(options, frames, dice)
        height, width = images.shape[2:]
        work = work_planes(window.maps)
        shape = (frames, views, -1, height // CELL, width // CELL)
        clean = network.latents(F.avg_pool2d(images, CELL)).reshape(shape)
        guess = network.latents(cells(work)).reshape(shape)
        counts = torch.arange(frames) >= finished
        noise, noisy = _noisy(clean, erring(clean, dice) if dice.unit() < options.errors else clean, sigmas, counts, dice)
        rays = token_rays(window.maps.cameras, height, width).reshape(frames, views, height // 32, width // 32, -1)
        rows.append((work, guess, clean, noise, noisy, sigmas, counts, rays, ego_numbers(window.action)))
        # The frames with the most noise and with the least, of those that are not finished.
        places = sorted({finished + int(sigmas[finished:].argmax()), finished + int(sigmas[finished:].argmin())})
        chosen = [frame * views + view for frame in places for view in range(views)]
        planes = full_planes(Maps(*(each[chosen] for each in window.maps)))
        for place, image in enumerate(chosen):
            for _ in range(options.crops):
                top, left = (dice.below((side - crop) // 32 + 1) * 32 for side, crop in zip((height, width), options.crop))
                cut = (slice(None), slice(top, top + options.crop[0]), slice(left, left + options.crop[1]))
                index = torch.tensor([number * frames * views + image, top // CELL, left // CELL])
                crops.append((planes[place][cut], images[image][cut], index))
    work, *others = zip(*rows)
    stacked = [torch.stack(each) for each in others]
    planes, truth, places = (torch.stack(each) for each in zip(*crops))
    return Prepared(torch.cat(work), *stacked, planes, truth, places)


def _noisy(clean: Tensor, wrong: Tensor, sigmas: Tensor, counts: Tensor, dice: Dice) -> tuple[Tensor, Tensor]:
    """Return noise and noisy latents.

    Finished frames have errors and no noise. The others have errors too, less so at low levels; the noise is changed to what
    leads from the noisy latents to the clean ones.
    """
    s = sigmas[:, None, None, None, None]
    noise = dice.normal(clean) + (wrong - clean) * (s / 0.3).clamp(max=1) * (1 - s) / s
    noisy = (1 - s) * clean + s * noise
    return noise, torch.where(counts[:, None, None, None, None], noisy, wrong)


class Losses(NamedTuple):
    """Losses of a step."""

    total: Tensor
    answer: Tensor
    absolute: Tensor
    square: Tensor
    images: Tensor
    """Decoded crops."""


def predict(network: SmallNetwork, batch: Prepared) -> tuple[Tensor, Tensor, Features]:
    """Return the answers, the clean latents that they mean, and the features."""
    B, L, V = batch.clean.shape[:3]
    features = network.encoder(batch.work)
    levels = network.levels(batch.sigmas)
    of_window = features.at16.reshape(B, L, V, *features.at16.shape[1:])
    answer = network.denoiser(levels.shown(batch.noisy, batch.guess), batch.sigmas, of_window, batch.rays, batch.ego)
    return answer, levels.clean(batch.noisy, batch.guess, answer), features


def crop_features(features: Features, latents: Tensor, batch: Prepared) -> tuple[Features, Tensor]:
    """Return features and latents ``[N, .., h, w]`` of the crops."""
    high, wide = (side // CELL for side in batch.truth.shape[2:])

    def cut(x: Tensor, factor: int) -> Tensor:
        return torch.stack(
            [x[i, :, t * factor : (t + high) * factor, l * factor : (l + wide) * factor] for i, t, l in batch.places.tolist()]
        )

    return Features(cut(features.at4, 4), cut(features.at8, 2), cut(features.at16, 1)), cut(latents, 1)


def losses(network: SmallNetwork, batch: Prepared, options: StepOptions) -> Losses:
    """Return the losses of the answers and of the decoded images."""
    answer, latents, features = predict(network, batch)
    target = network.levels(batch.sigmas).answer(batch.clean, batch.guess, batch.noise)
    # All levels weigh the same. A frame whose guess is worse than usual, since conditions were dropped, weighs less, or these
    # few frames would dominate the training.
    usual = network.priors[:, None, None] / options.expected_error
    off = ((batch.clean - batch.guess) / usual).square().mean((2, 3, 4, 5)).clamp(min=1)
    weights = batch.counts / off
    of_channels = (network.priors / network.priors.mean())[:, None, None]
    squares = ((answer.float() - target).square() * of_channels).mean((2, 3, 4, 5))
    answer_loss = (squares * weights).sum() / batch.counts.sum().clamp(min=1)
    cropped, cut = crop_features(features, latents.detach().flatten(0, 2), batch)
    images = network.decoder(batch.planes, cropped, cut).float()
    weight = 1 / off.flatten().sqrt()
    per_frame = batch.clean.shape[2]
    weight = weight[batch.places[:, 0] // per_frame][:, None, None, None]
    error = (images - batch.truth) * weight
    absolute, square = error.abs().mean(), error.square().mean()
    total = answer_loss + options.absolute * absolute + options.square * square
    return Losses(total, answer_loss.detach(), absolute.detach(), square.detach(), images)


class Discriminator(nn.Module):
    """Discriminator of patches, which sees the filled color too. Source: Isola et al., "Image-to-Image Translation with
    Conditional Adversarial Networks", 2017; Miyato et al., "Spectral Normalization", 2018."""

    def __init__(self, channels: tuple[int, ...] = (32, 64, 128)) -> None:
        super().__init__()
        spectral = nn.utils.parametrizations.spectral_norm
        layers, before = [], 7
        for number, count in enumerate(channels):
            layers.append(spectral(nn.Conv2d(before, count, 4, stride=2, padding=1)))
            before = count
        self.layers = nn.ModuleList(layers)
        self.out = spectral(nn.Conv2d(before, 1, 3, padding=1))

    def forward(self, images: Tensor, planes: Tensor) -> list[Tensor]:
        """Return the features of each layer, and the answers."""
        x = torch.cat([4 * (images - 0.5), planes[:, :4]], 1)
        outputs = []
        for layer in self.layers:
            x = F.leaky_relu(layer(x), 0.2)
            outputs.append(x)
        return [*outputs, self.out(x)]
