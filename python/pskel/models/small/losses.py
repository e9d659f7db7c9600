"""Losses of the answers and of the decoded images, and the discriminator."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .draws import Batch, Statistics
from .levels import Levels

__all__ = ["Discriminator", "answer_loss", "guess_errors", "image_weights", "similarity", "texture_errors"]


def guess_errors(batch: Batch, statistics: Statistics, expected_error: float) -> Tensor:
    """Return the mean square error of each frame's guess, ``[B, L]``, relative to its average over the data; at least 1."""
    usual = statistics.priors[:, None, None] / expected_error
    return ((batch.clean - batch.guess) / usual).square().mean((2, 3, 4, 5)).clamp(min=1)


def answer_loss(answer: Tensor, batch: Batch, statistics: Statistics, errors: Tensor) -> Tensor:
    """Return the mean square error of the answers; all noise levels weigh the same.

    A frame whose guess is worse than usual, since conditions were dropped, weighs less, or these few frames would dominate the
    training.
    """
    target = Levels(batch.window.sigmas, statistics.priors).answer(batch.clean, batch.guess, batch.noise)
    channels = (statistics.priors / statistics.priors.mean())[:, None, None]
    squares = ((answer.float() - target).square() * channels).mean((2, 3, 4, 5))
    return (squares * batch.counts / errors).sum() / batch.counts.sum().clamp(min=1)


def image_weights(batch: Batch, errors: Tensor) -> Tensor:
    """Return the weight of each crop's error, ``[K, 1, 1, 1]``; smaller where conditions were dropped."""
    views = batch.clean.shape[2]
    return errors.flatten().rsqrt()[batch.places[:, 0] // views][:, None, None, None]


def similarity(images: Tensor, truth: Tensor) -> Tensor:
    """Return the structural similarity of each image ``[K, 3, H, W]``, 0 to 1: ``[K]``, as ``pskel evaluate`` computes it.

    Source: Wang et al., "Image Quality Assessment: From Error Visibility to Structural Similarity", 2004.
    """
    with torch.autocast(images.device.type, enabled=False):
        x, y = images.float(), truth.float()
        taps = torch.exp(-(torch.arange(-5, 6, device=x.device, dtype=x.dtype) ** 2) / (2 * 1.5**2))
        taps = taps / taps.sum()
        planes = torch.cat([x, y, x * x, y * y, x * y], 1)
        taps = taps.repeat(planes.shape[1], 1)
        across = F.conv2d(planes, taps[:, None, None], groups=len(taps))
        mx, my, xx, yy, xy = F.conv2d(across, taps[:, None, :, None], groups=len(taps)).chunk(5, 1)
        c1, c2 = 0.01**2, 0.03**2
        structure = (2 * (xy - mx * my) + c2) / (xx - mx * mx + yy - my * my + c2)
        return ((2 * mx * my + c1) / (mx * mx + my * my + c1) * structure).mean((1, 2, 3))


def texture_errors(images: Tensor, truth: Tensor) -> Tensor:
    """Return how much the mean gradient magnitudes of 8x8 pixels differ, of each image ``[K, 3, H, W]``, 0 to 1: ``[K]``.

    The mean of all possible images, which the other errors ask for, is smoother than each of them; this one asks for as much
    contrast as the truth has, wherever its edges are. Source, with other features: Sajjadi et al., "EnhanceNet: Single Image
    Super-Resolution Through Automated Texture Synthesis", 2017 (statistics of patches).
    """

    def gradients(image: Tensor) -> Tensor:
        levels = image.float().mean(1, keepdim=True)
        right, below = levels.diff(dim=3)[:, :, :-1], levels.diff(dim=2)[:, :, :, :-1]
        return F.avg_pool2d((right.square() + below.square() + 1e-6).sqrt(), 8)

    return (gradients(images) - gradients(truth)).abs().mean((1, 2, 3))


class Discriminator(nn.Module):
    """Discriminator of patches, which sees the filled color and depth too.

    Sources: Isola et al., "Image-to-Image Translation with Conditional Adversarial Networks", 2017; Miyato et al., "Spectral
    Normalization for Generative Adversarial Networks", 2018.
    """

    def __init__(self, channels: tuple[int, ...] = (32, 64, 128)) -> None:
        super().__init__()
        spectral = nn.utils.parametrizations.spectral_norm
        widths = (7, *channels)
        pairs = zip(widths, widths[1:])
        self.layers = nn.ModuleList(spectral(nn.Conv2d(a, b, 4, stride=2, padding=1)) for a, b in pairs)
        self.out = spectral(nn.Conv2d(widths[-1], 1, 3, padding=1))

    def forward(self, images: Tensor, planes: Tensor) -> list[Tensor]:
        """Return the features of each layer, and the answers, for images ``[K, 3, H, W]`` and their ``full_planes``."""
        x = torch.cat([4 * (images - 0.5), planes[:, :4]], 1)
        outputs = []
        for layer in self.layers:
            x = F.leaky_relu(layer(x), 0.2)
            outputs.append(x)
        return [*outputs, self.out(x)]
