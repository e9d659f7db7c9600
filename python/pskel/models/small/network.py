"""The network: an encoder of conditions, a denoiser of latents at low resolution, and a decoder at full resolution.

The encoder turns the conditions of a frame, reduced to a quarter of the size, into features at four sizes, once per frame. The
denoiser works on latents, the mean colors of 16x16 pixels, with attention within images, across cameras and over time. The
decoder turns a finished latent into images; it sees the conditions again, at full size. Sources: Ronneberger et al., "U-Net",
2015; Peebles and Xie, "Scalable Diffusion Models with Transformers", 2023; Dehghani et al., "Scaling Vision Transformers to 22
Billion Parameters", 2023 (normed queries and keys, parallel layers); Chen et al., "Diffusion Forcing", 2024 (a noise level per
frame); Shi et al., "Real-Time Single Image and Video Super-Resolution", 2016 (pixels as channels).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .config import CELL, LANES, LATENT_CHANNELS, PLANES, SmallConfig
from .inputs import CENTER, EGO, GAIN, RAY, cells
from .levels import Levels

WAVES = 32
EPSILON = 1e-6
FIRST_GATE = 0.1
SLOPE = 0.1
"""Slope of rectified numbers below 0."""


def _normal(parameter: Tensor, spread: float) -> None:
    nn.init.normal_(parameter, std=spread)


def _linear(inputs: int, outputs: int, gain: float = 1.0, bias: bool = False) -> nn.Linear:
    linear = nn.Linear(inputs, outputs, bias=bias)
    _normal(linear.weight, gain / inputs**0.5)
    if bias:
        nn.init.zeros_(linear.bias)
    return linear


def _convolution(inputs: int, outputs: int, gain: float = 1.0) -> nn.Conv2d:
    convolution = nn.Conv2d(inputs, outputs, 3, padding=1)
    _normal(convolution.weight, gain * (2 / (9 * inputs)) ** 0.5)  # He et al., "Delving Deep into Rectifiers", 2015
    assert convolution.bias is not None
    nn.init.zeros_(convolution.bias)
    return convolution


def _rectified(x: Tensor) -> Tensor:
    return F.leaky_relu(x, SLOPE)


def _halved(x: Tensor) -> Tensor:
    return F.avg_pool2d(x, 2)


def _doubled(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)


def _modulated(x: Tensor, shift: Tensor, scale: Tensor) -> Tensor:
    """Scale the last axis to zero mean and unit variance, then modulate it."""
    return F.layer_norm(x, x.shape[-1:], eps=EPSILON) * (1 + scale) + shift


class Stage(nn.Module):
    """Two convolutions, each rectified."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.a = _convolution(inputs, outputs)
        self.b = _convolution(outputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        return _rectified(self.b(_rectified(self.a(x))))


class Features(NamedTuple):
    """Encoded conditions, ``[N, C, H, W]`` at 1/4, 1/8 and 1/16 of the size."""

    at4: Tensor
    at8: Tensor
    at16: Tensor


class Window(NamedTuple):
    """Noisy windows: B windows of L frames and V cameras."""

    work: Tensor
    """Conditions, ``inputs.work_planes``: ``[B L V, 16, H/4, W/4]``."""
    noisy: Tensor
    """Noisy latents, ``[B, L, V, 3, h, w]``."""
    sigmas: Tensor
    """Noise of each frame, ``[B, L]``."""
    rays: Tensor
    """``inputs.token_rays``: ``[B, L, V, h/2, w/2, 27]``."""
    ego: Tensor
    """``inputs.ego_numbers``: ``[B, L, 4]``."""


class Encoder(nn.Module):
    """Encoder of conditions at a quarter of the size."""

    def __init__(self, config: SmallConfig) -> None:
        super().__init__()
        c4, c8, c16, c32 = config.encoder
        self.at4 = Stage(PLANES, c4)
        self.at8 = Stage(c4, c8)
        self.at16 = Stage(c8, c16)
        self.at32 = Stage(c16, c32)
        self.up16 = Stage(c32 + c16, c16)

    def forward(self, planes: Tensor) -> Features:
        """Encode the conditions of 4x4 pixels, ``[N, 16, H/4, W/4]``."""
        at4 = self.at4(planes)
        at8 = self.at8(_halved(at4))
        at16 = self.at16(_halved(at8))
        at32 = self.at32(_halved(at16))
        return Features(at4, at8, self.up16(torch.cat([_doubled(at32), at16], 1)))


class Residual(nn.Module):
    """Two convolutions after a modulated norm, added with a gate."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.a = _convolution(channels, channels)
        self.b = _convolution(channels, channels, 0.5)

    def forward(self, x: Tensor, modulation: Tensor) -> Tensor:
        """Take ``x [N, C, h, w]`` and ``modulation [N, 3 C]``."""
        shift, scale, gate = modulation[:, None, None].chunk(3, -1)
        normed = _modulated(x.permute(0, 2, 3, 1), shift, scale).permute(0, 3, 1, 2)
        added: Tensor = self.b(_rectified(self.a(normed)))
        return x + gate.permute(0, 3, 1, 2) * added


class Block(nn.Module):
    """Attention and a hidden layer in parallel."""

    def __init__(self, config: SmallConfig, attend: str) -> None:
        super().__init__()
        self.attend = attend
        self.head = config.head
        self.widths = [config.width] * 3 + [config.hidden]
        self.into = _linear(config.width, sum(self.widths))
        self.out = _linear(config.width + config.hidden, config.width)

    def forward(self, x: Tensor, modulation: Tensor) -> Tensor:
        """Take tokens ``[B, L, V, h, w, d]`` and ``modulation [B, L, 3 d]``."""
        shift, scale, gate = modulation[:, :, None, None, None].chunk(3, -1)
        q, k, v, hidden = self.into(_modulated(x, shift, scale)).split(self.widths, -1)
        seen = self._attention(q, k, v)
        added: Tensor = self.out(torch.cat([seen, F.gelu(hidden, approximate="tanh")], -1))
        return x + gate * added

    def _attention(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        B, L, V, h, w, d = q.shape
        order = {"s": (0, 1, 2, 3, 4), "v": (0, 1, 3, 2, 4), "t": (0, 2, 3, 4, 1)}[self.attend]
        tokens = {"s": h * w, "v": V * w, "t": L}[self.attend]
        # [groups, heads, tokens, head]
        q, k, v = (
            each.permute(*order, 5).reshape(-1, tokens, d // self.head, self.head).transpose(1, 2) for each in (q, k, v)
        )
        q, k = (F.rms_norm(each, each.shape[-1:], eps=EPSILON) for each in (q, k))
        seen = F.scaled_dot_product_attention(q, k, v)
        shape = [(B, L, V, h, w)[axis] for axis in order]
        back = [order.index(axis) for axis in range(5)]
        return seen.transpose(1, 2).reshape(*shape, d).permute(*back, 5)


class Denoiser(nn.Module):
    """Denoiser of latents, with features, rays and ego motion as conditions."""

    frequencies: Tensor

    def __init__(self, config: SmallConfig) -> None:
        super().__init__()
        self.config = config
        d, channels = config.width, config.encoder[2]
        self.latent = _linear(LATENT_CHANNELS, channels)
        self.conditions = _linear(channels, channels)
        self.tokens_in = _linear(channels, d)
        self.tokens_out = _linear(d, channels, 0.5)
        self.rays = _linear(RAY, d)
        self.frame = nn.Parameter(torch.empty(config.frames, d).normal_(std=0.02))
        self.level_a = _linear(2 * WAVES, d, bias=True)
        self.level_b = _linear(d, d)
        self.ego_a = _linear(EGO, d)
        self.ego_b = _linear(d, d)
        self.first = Residual(channels)
        self.blocks = nn.ModuleList(Block(config, attend) for attend in config.blocks)
        self.last = Residual(channels)
        self.out = _linear(channels, LATENT_CHANNELS, 0.1)
        self.columns = [3 * d] * len(config.blocks) + [3 * channels] * 2 + [2 * channels]
        self.modulation = _linear(d, sum(self.columns), 0.02, bias=True)
        with torch.no_grad():
            for part in torch.split(self.modulation.bias, self.columns)[:-1]:  # the gates
                part[2 * len(part) // 3 :] = FIRST_GATE
        self.register_buffer("frequencies", 0.5 * 200.0 ** (torch.arange(WAVES) / (WAVES - 1)), persistent=False)

    def forward(self, shown: Tensor, sigmas: Tensor, features: Tensor, rays: Tensor, ego: Tensor) -> Tensor:
        """Return the answer to noisy latents.

        Parameters
        ----------
        shown : Tensor
            Latents as ``Levels.shown`` returns them, ``[B, L, V, 3, h, w]``.
        sigmas : Tensor
            Noise levels, ``[B, L]``.
        features : Tensor
            ``[B, L, V, C, h, w]``.
        rays : Tensor
            ``[B, L, V, h/2, w/2, 27]``.
        ego : Tensor
            ``[B, L, 4]``.
        """
        B, L, V, _, h, w = shown.shape
        angle = sigmas[..., None] * self.frequencies
        waves = torch.stack([angle.sin(), angle.cos()], -1).flatten(-2)
        level = self.level_b(F.silu(self.level_a(waves))) + self.ego_b(F.silu(self.ego_a(ego)))
        *blocks, first, last, end = self.modulation(F.silu(level)).split(self.columns, -1)

        def per_image(modulation: Tensor) -> Tensor:
            return modulation[:, :, None].expand(B, L, V, -1).reshape(B * L * V, -1)

        def pixels(x: Tensor) -> Tensor:
            return x.reshape(B * L * V, -1, h, w).permute(0, 2, 3, 1)

        x = (self.latent(pixels(shown)) + self.conditions(pixels(features))).permute(0, 3, 1, 2)
        x = self.first(x, per_image(first))
        tokens = self.tokens_in(_halved(x).permute(0, 2, 3, 1)).reshape(B, L, V, h // 2, w // 2, -1)
        tokens = tokens + self.rays(rays) + self.frame[None, :L, None, None, None]
        for block, modulation in zip(self.blocks, blocks):
            tokens = block(tokens, modulation)
        added = self.tokens_out(tokens).reshape(B * L * V, h // 2, w // 2, -1).permute(0, 3, 1, 2)
        x = self.last(x + _doubled(added), per_image(last))
        shift, scale = per_image(end)[:, None, None].chunk(2, -1)
        answer: Tensor = self.out(_modulated(x.permute(0, 2, 3, 1), shift, scale))
        return answer.permute(0, 3, 1, 2).reshape(B, L, V, -1, h, w)


class Decoder(nn.Module):
    """Decoder of latents into images, with the conditions at full size."""

    def __init__(self, config: SmallConfig) -> None:
        super().__init__()
        c2, c4, c8, c16 = config.decoder
        f4, f8, f16, _ = config.encoder
        self.down2 = Stage(4 * PLANES, c2)
        self.down4 = Stage(c2 + f4, c4)
        self.down8 = Stage(c4 + f8, c8)
        self.middle = Stage(c8 + f16 + LANES, c16)
        self.up8 = Stage(c16 + c8, c8)
        self.up4 = Stage(c8 + c4, c4)
        self.up2 = Stage(c4 + c2, c2)
        self.out = _convolution(c2, LANES, 0.0)  # the first images are the filled colors

    def forward(self, planes: Tensor, features: Features, latents: Tensor) -> Tensor:
        """Return images ``[N, 3, H, W]``, about 0 to 1, of finished latents ``[N, 3, h, w]``.

        ``planes`` are ``[N, 16, H, W]``.
        """
        at2 = self.down2(F.pixel_unshuffle(planes, 2))
        at4 = self.down4(torch.cat([_halved(at2), features.at4], 1))
        at8 = self.down8(torch.cat([_halved(at4), features.at8], 1))
        none = latents.new_zeros(len(latents), LANES - LATENT_CHANNELS, *latents.shape[2:])
        x = self.middle(torch.cat([_halved(at8), features.at16, latents, none], 1))
        x = self.up8(torch.cat([_doubled(x), at8], 1))
        x = self.up4(torch.cat([_doubled(x), at4], 1))
        x = self.up2(torch.cat([_doubled(x), at2], 1))
        added = F.pixel_shuffle(self.out(x)[:, :12], 2)
        return added + planes[:, :3] / GAIN + CENTER


class SmallNetwork(nn.Module):
    """The network that ships."""

    means: Tensor
    scales: Tensor
    priors: Tensor

    def __init__(self, config: SmallConfig | None = None) -> None:
        super().__init__()
        self.config = config or SmallConfig()
        self.encoder = Encoder(self.config)
        self.denoiser = Denoiser(self.config)
        self.decoder = Decoder(self.config)
        # Statistics of the training images: mean colors, standard deviations of latents, errors of the denoiser.
        for name, value in (("means", 0.0), ("scales", 1.0), ("priors", 1.0)):
            self.register_buffer(name, torch.full((LATENT_CHANNELS,), value))

    def latents(self, cells: Tensor) -> Tensor:
        """Return latents of mean colors ``[..., 3, h, w]``, 0 to 1."""
        return (cells - self.means[:, None, None]) / self.scales[:, None, None]

    def levels(self, sigmas: Tensor) -> Levels:
        """Return the preconditioning of noise levels ``[B, L]``."""
        return Levels(sigmas, self.priors)

    def answer(self, window: Window) -> tuple[Tensor, Features]:
        """Return the answer to the noisy latents of windows, and the features of their frames."""
        B, L, V = window.noisy.shape[:3]
        features = self.encoder(window.work)
        levels = self.levels(window.sigmas)
        at16 = features.at16.reshape(B, L, V, *features.at16.shape[1:])
        guess = self.latents(cells(window.work)).reshape(window.noisy.shape)
        answer = self.denoiser(levels.shown(window.noisy, guess), window.sigmas, at16, window.rays, window.ego)
        return answer, features

    def clean(self, window: Window, answer: Tensor) -> Tensor:
        """Return the clean latents that an answer means, ``[B, L, V, 3, h, w]``."""
        guess = self.latents(cells(window.work)).reshape(window.noisy.shape)
        return self.levels(window.sigmas).clean(window.noisy, guess, answer)

    def forward(self, window: Window, planes: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Return the answer to noisy latents, and crops ``[K, 3, H, W]`` of the images that it means.

        ``planes`` are crops of the conditions ``[K, 16, H, W]``. ``places`` ``[K, 3]`` are the image, top and left of each, in
        16x16 pixels.
        """
        answer, features = self.answer(window)
        latents = self.clean(window, answer).detach().flatten(0, 2)
        high, wide = (side // CELL for side in planes.shape[2:])

        def cut(x: Tensor, factor: int) -> Tensor:
            parts = [
                x[image, :, top * factor : (top + high) * factor, left * factor : (left + wide) * factor]
                for image, top, left in places.tolist()
            ]
            return torch.stack(parts)

        cropped = Features(cut(features.at4, 4), cut(features.at8, 2), cut(features.at16, 1))
        return answer, self.decoder(planes, cropped, cut(latents, 1))
