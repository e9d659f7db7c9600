"""Outputs of the small network for frames that Rust makes too: `python parity.py` writes the files of ``crates/network/tests/parity``.

Frames, latents and noise levels follow from whole numbers, as ``pskel_testing::small_network::clip_for`` has them.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
from pskel.models.small.config import CELL, SmallConfig
from pskel.models.small.inputs import Maps, cells, ego_numbers, full_planes, token_rays, work_planes
from pskel.models.small.network import SmallNetwork
from pskel.models.small.weights import load, save
from safetensors.torch import save_file
from torch import Tensor

CRATE = Path(__file__).parents[3] / "crates" / "network"
FOLDER = CRATE / "tests" / "parity"
SHIPPED = CRATE / "shipped" / "weights.safetensors"
VIEWS = 2
SIGMAS = (0.9, 0.5, 0.1)
SMALL = SmallConfig(
    recipe={"drawn": "32x64", "size": "32x64"},
    encoder=(16, 16, 16, 16),
    decoder=(16, 16, 16, 16),
    width=32,
    head=16,
    hidden=48,
    blocks="svt",
)
STEP = 7
"""One of this many numbers of the shipped network's images is stored."""


def frame(height: int, width: int, number: int, frame: int) -> tuple[Maps, Tensor]:
    """Return the maps and the ego motion of a frame."""
    view, y, x = np.meshgrid(np.arange(VIEWS), np.arange(height), np.arange(width), indexing="ij")
    kind = (x // 16 + 3 * (y // 16) + 2 * view + frame + number) * 5 % 7 % 4
    seed = (kind * 48 + (y % 4) * 12 + (x % 4) * 3)[..., None] + np.arange(3) + 1
    shade = (seed.astype(np.uint64) * 2654435761 % 2**32) >> 24
    hole = (x * 7 + y * 3 + frame) % 5 != 0
    color = np.where(hole[..., None], 0, np.maximum(shade, 1))
    bins = np.where(hole, 0, 1 + (y * 8 + x) % 256)
    boxes = np.stack([255 * (x // 16 == frame % 4), 0 * x, 0 * x], -1)
    outlines = 255 * np.stack([kind & 1, (x // 16 + y // 16) & 1, 0 * x], -1)

    def rgb(values: np.ndarray) -> Tensor:
        return torch.from_numpy(values.astype(np.float32)).permute(0, 3, 1, 2) / 255

    depth = torch.from_numpy(np.where(bins > 0, np.minimum(bins, 255).astype(np.float32) / np.float32(255), -1)).float()
    cameras = []
    for yaw in (np.float32(0.5) - np.float32(view) for view in range(VIEWS)):
        sin, cos = np.sin(yaw), np.cos(yaw)
        cameras.append([sin, 0, cos, 1, -cos, 0, sin, 0, 0, -1, 0, 1.5, 0.8, 1.4, 0.5, 0.5])
    maps = Maps(rgb(color), depth[:, None], rgb(boxes), rgb(outlines), torch.tensor(np.array(cameras, np.float32)))
    return maps, torch.tensor([1.0, np.float32(0.1) * frame, 0.02])


def outputs(network: SmallNetwork, step: int) -> dict[str, Tensor]:
    """Return the velocity of a window and the images of its last frame, of which one number in ``step`` is left."""
    height, width = network.config.size
    frames = len(SIGMAS)
    shape = (1, frames, VIEWS, 3, height // CELL, width // CELL)
    noisy = torch.tensor([1.3 * math.sin(0.37 * i) for i in range(math.prod(shape))]).reshape(shape)
    made = [frame(height, width, 1, number) for number in range(frames)]
    maps = Maps(*(torch.cat(parts) for parts in zip(*(maps for maps, _ in made))))
    sigmas = torch.tensor([SIGMAS])
    network = network.eval()
    with torch.no_grad():
        work = work_planes(maps)
        features = network.encoder(work)
        guess = network.latents(cells(work)).reshape(shape)
        rays = token_rays(maps.cameras, height, width).reshape(1, frames, VIEWS, height // 32, width // 32, -1)
        ego = ego_numbers(torch.stack([action for _, action in made]))[None]
        levels = network.levels(sigmas)
        of_window = features.at16.reshape(1, frames, VIEWS, *features.at16.shape[1:])
        answer = network.denoiser(levels.shown(noisy, guess), sigmas, of_window, rays, ego)
        clean = levels.clean(noisy, guess, answer)
        last = slice((frames - 1) * VIEWS, None)
        features_of_last = type(features)(*(each[last] for each in features))
        planes = full_planes(Maps(*(each[last] for each in maps)))
        images = network.decoder(planes, features_of_last, noisy[0, -1]).permute(0, 2, 3, 1)
    velocity = levels.velocity(noisy, clean)[0]
    return {"velocity": velocity.contiguous(), "images": images.flatten()[::step].contiguous()}


def small() -> SmallNetwork:
    """Return a network of small dimensions with random weights."""
    torch.manual_seed(5)
    network = SmallNetwork(SMALL)
    for name, values in (("means", (0.4, 0.45, 0.5)), ("scales", (0.2, 0.25, 0.3)), ("priors", (0.3, 0.4, 0.5))):
        getattr(network, name).copy_(torch.tensor(values))
    with torch.no_grad():
        for parameter in network.parameters():  # biases too, and outputs that are near zero at first
            if parameter.dim() == 1 or len(parameter) in (3, 16):
                parameter.add_(torch.randn_like(parameter) * 0.1)
    return network


def main() -> None:
    """Write the files."""
    save(small(), FOLDER / "small.safetensors")
    save_file(outputs(load(FOLDER / "small.safetensors"), 1), FOLDER / "small-outputs.safetensors")
    save_file(outputs(load(SHIPPED), STEP), FOLDER / "shipped-outputs.safetensors")


if __name__ == "__main__":
    main()
