"""A recorded drive along a smooth panorama, an autoencoder that fits it, and its frames as conditions of a rollout."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from diffusers import AutoencoderKL
from pas_base import Array
from pskel.models.pas import FrameCondition
from pskel.train.data.recorded import Recorder

CAMERAS = ("CAM_LEFT", "CAM_RIGHT")
SIZE = (32, 64)
HZ = 5.0
_SHIFT = 6
"""Pixels from frame to frame."""
RECIPE = {"drawn": "64x128", "size": f"{SIZE[0]}x{SIZE[1]}"}


class Drive(NamedTuple):
    """Arrays of F frames and V cameras, as in a file of recorded clips."""

    maps: dict[str, Any]
    """``color``, ``boxes``, ``map`` and ``truth``, ``uint8 [F, V, H, W, 3]``; ``bins``, ``uint16 [F, V, H, W]``."""
    action: Any
    cameras: Any

    @property
    def images(self) -> torch.Tensor:
        """``float32 [F, V, 3, H, W]``, 0 to 1."""
        return torch.from_numpy(self.maps["truth"]).permute(0, 1, 4, 2, 3) / 255.0

    def condition(self, frame: int) -> FrameCondition:
        """The frame as a rollout shows it to the network; its depth is (bin - 1) / 255."""
        part = {name: array[frame].astype(np.float32) for name, array in self.maps.items()}
        rgb = {name: part[name].transpose(0, 3, 1, 2) / 255.0 for name in ("color", "boxes", "map")}
        depth = np.where(part["bins"] > 0, np.minimum(part["bins"], 255) / 255.0, -1.0)
        return FrameCondition.create(
            np.concatenate([rgb["color"], depth[:, None]], axis=1),
            np.concatenate([rgb["boxes"], rgb["map"]], axis=1),
            self.action[frame],
            self.cameras[frame],
        )


def drive(frames: int) -> Drive:
    """The cameras look at two places of a panorama that moves past them. Half of the color map is empty."""
    random = torch.Generator().manual_seed(11)
    height, width = SIZE
    length = 2 * width + _SHIFT * frames

    def panorama(rows: int, pixels: int) -> torch.Tensor:
        small = torch.rand(1, 3, rows, length // pixels, generator=random)
        return torch.nn.functional.interpolate(small, (height, length), mode="bilinear", align_corners=True)[0]

    def seen(whole: torch.Tensor) -> torch.Tensor:
        starts = [[_SHIFT * frame + view * width for view in range(len(CAMERAS))] for frame in range(frames)]
        views = [torch.stack([whole[:, :, start : start + width] for start in each]) for each in starts]
        return (torch.stack(views).permute(0, 1, 3, 4, 2) * 255.0).round().to(torch.uint8)

    images, boxes, road = seen(panorama(4, 12)), seen(panorama(4, 12)), seen(panorama(4, 12))
    filled = torch.rand(images.shape[:-1], generator=random) < 0.5
    bins = torch.where(filled, 1 + images[..., 0].int(), 0)
    maps = {"color": images * filled.unsqueeze(-1), "boxes": boxes, "map": road, "truth": images, "bins": bins}
    pose = torch.eye(4)[:3].repeat(len(CAMERAS), 1, 1)
    pose[:, 1, 3] = torch.tensor([0.5, -0.5])
    fractions = torch.tensor([0.8, 1.4, 0.5, 0.5]).expand(len(CAMERAS), 4)
    return Drive(
        {name: array.numpy().astype(np.uint16 if name == "bins" else np.uint8) for name, array in maps.items()},
        np.tile(np.array([0.9, 0.0, 0.0], np.float32), (frames, 1)),
        torch.cat([pose.flatten(1), fractions], dim=1).expand(frames, -1, -1).numpy(),
    )


def write_drive(path: Path, of: Drive) -> Path:
    """Write the drive as recorded clips."""
    frames = len(of.action)
    about = {"log": "panorama", "source": "test", "hz": HZ, "cameras": list(CAMERAS), "recipe": RECIPE}
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 0, 3] = of.action[0, 0] * np.arange(frames)
    arrays = {
        **of.maps,
        "action": of.action,
        "cameras": of.cameras,
        "global_from_ego": poses,
        "t_us": np.arange(frames) * 200_000,
        "original_sizes": np.array([SIZE] * len(CAMERAS)),
    }
    with Recorder(path, about, {"runs": [[0, frames]]}, frames) as recorder:
        for name, array in arrays.items():
            recorder.write(name, array)
    return path


def fit_codec(base: Path, of: Drive, steps: int) -> None:
    """Train the random autoencoder of a folder on the drive, and set shift and scale by its latents."""
    images = of.images.flatten(0, 1) * 2.0 - 1.0
    vae: Any = AutoencoderKL.from_pretrained(base / "vae")
    optimizer = torch.optim.Adam(vae.parameters(), lr=3e-3)
    random = torch.Generator().manual_seed(1)
    for number in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = 3e-3 * (1.0 - number / steps)
        batch = images[torch.randint(0, len(images), (12,), generator=random)]
        z = vae.encode(batch).latent_dist.mean
        error = (vae.decode(z).sample - batch).square().mean()
        optimizer.zero_grad()
        torch.autograd.backward(error + 1e-3 * z.square().mean())
        optimizer.step()
    bias, weight = vae.encoder.conv_out.bias, vae.encoder.conv_out.weight
    with torch.no_grad():  # a narrow posterior
        weight[len(bias) // 2 :], bias[len(bias) // 2 :] = 0.0, -12.0
        z = vae.encode(images).latent_dist.mean
    vae.save_pretrained(base / "vae")
    path = base / "vae" / "config.json"
    numbers = {"shift_factor": float(z.mean()), "scaling_factor": 1.0 / float(z.std())}
    path.write_text(json.dumps({**json.loads(path.read_text()), **numbers}))


def psnr(found: Array, expected: Array) -> float:
    """Peak signal-to-noise ratio of images, 0 to 1, in dB."""
    return float(-10.0 * np.log10(np.square(np.asarray(found) - np.asarray(expected)).mean()))
