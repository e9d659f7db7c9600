"""Training clips of random maps and smooth images, a tiny network, and the task that trains it."""

import json
from pathlib import Path
from typing import Any

import torch
from pskel.train.clip import Clip

CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT")
SIZE = (32, 64)
SIZES: dict[str, Any] = {
    "num_layers": 2,
    "num_attention_heads": 4,
    "attention_head_dim": 32,
    "dual_attention_layers": [0],
    "crossview_block_layers": [0],
    "temporal_block_layers": [1],
    "sample_size": 16,
    "pos_embed_max_size": 24,
    "joint_attention_dim": 40,
    "caption_projection_dim": 128,
    "pooled_projection_dim": 24,
    "condition_image_adapter_config": {"in_channels": 6, "channels": [128], "is_downblocks": [True]},
    "condition_pc_adapter_config": {"in_channels": 20, "channels": [128], "is_downblocks": [True]},
}
"""Dimensions that fit the folder of ``pas_base.write_base``."""


def write_sizes(path: Path) -> Path:
    path.write_text(json.dumps(SIZES))
    return path


def clip(seed: int = 0, frames: int = 2, **changed: Any) -> Clip:
    """A clip whose images are smooth."""
    random = torch.Generator().manual_seed(seed)
    views, (height, width) = len(CAMERAS), SIZE

    def image() -> Any:
        small = torch.rand(frames * views, 3, 4, 8, generator=random)
        large = torch.nn.functional.interpolate(small, SIZE, mode="bilinear")
        return (large * 255).round().to(torch.uint8).view(frames, views, 3, height, width)

    bins = torch.randint(0, 257, (frames, views, height, width), generator=random).to(torch.int16)
    pose = torch.eye(4)[:3].repeat(frames, views, 1, 1) + 0.3 * torch.randn(1, views, 3, 4, generator=random)
    fractions = torch.tensor([0.8, 1.4, 0.5, 0.5]).expand(frames, views, 4)
    steps = torch.tensor([[0.9, 0.02, 0.01]]).repeat(frames, 1)
    values: dict[str, Any] = {
        "color": image() * (bins > 0).unsqueeze(2),
        "bins": bins,
        "boxes": image(),
        "map": image(),
        "images": image(),
        "cameras": torch.cat([pose.flatten(2), fractions], dim=-1),
        "action": steps,
        "global_from_ego": driven(steps),
        "t_us": torch.arange(frames) * 200_000,
        "original_sizes": torch.tensor([[900, 1600]] * views),
        "names": CAMERAS,
        "captions": (("Rain. Night", "Rain. Night", "Sun"),) * frames,
        "log": f"log-{seed}",
        "frame": 0,
        "hz": 5.0,
        "recipe": {"bins": {"count": 256, "far_m": 50.0, "scale": "linear"}},
    }
    return Clip(**{**values, **changed})


def driven(steps: Any) -> Any:
    """Poses ``float64 [L, 4, 4]`` far from the origin, after motions ``[L, 3]``; the first motion is not used."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:2, 3] = torch.tensor([664_000.0, 3_997_000.0])
    poses = [pose]
    for forward, left, yaw in steps[1:].double():
        motion = torch.eye(4, dtype=torch.float64)
        motion[:2, :2] = torch.stack([torch.stack([yaw.cos(), -yaw.sin()]), torch.stack([yaw.sin(), yaw.cos()])])
        motion[0, 3], motion[1, 3] = forward, left
        poses.append(poses[-1] @ motion)
    return torch.stack(poses)


def narrow_posterior(base: Path) -> None:
    """Change the random autoencoder of a folder: a narrow posterior, as a trained one's, and means that differ more."""
    from safetensors.torch import load_file, save_file

    path = base / "vae" / "diffusion_pytorch_model.safetensors"
    weights = load_file(path)
    bias, weight = weights["encoder.conv_out.bias"], weights["encoder.conv_out.weight"]
    half = len(bias) // 2
    weight[half:], bias[half:] = 0.0, -12.0
    weight[:half] *= 4.0
    save_file(weights, path, {"format": "pt"})
