"""A folder of Stable Diffusion 1.5 with random weights of a few channels, and training clips."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "pas"))  # its messages, peers and tokenizers
from pas_base import Array, Peer, pack, unpack, write_clip_tokenizer  # noqa: E402
from pskel.models.pas_image.config import TINY  # noqa: E402

__all__ = ["CAMERAS", "Array", "Peer", "base", "clip", "pack", "random_weights", "unpack", "write_base"]

CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT")
RECIPE = {"bins": {"count": 256, "scale": "linear", "far_m": 100.0, "gamma": 1.0}}


def write_base(folder: Path) -> Path:
    """Write a UNet with the sizes of ``TINY``, an autoencoder of 4 latent channels, and a text encoder of 24 channels."""
    from diffusers import AutoencoderKL, UNet2DConditionModel
    from transformers import CLIPTextConfig, CLIPTextModel

    torch.manual_seed(5)
    UNet2DConditionModel(sample_size=64, **TINY.unet).save_pretrained(folder / "unet")
    vae = AutoencoderKL(
        down_block_types=("DownEncoderBlock2D",) * 4,
        up_block_types=("UpDecoderBlock2D",) * 4,
        block_out_channels=(8, 8, 8, 8),
        layers_per_block=1,
        norm_num_groups=4,
        latent_channels=4,
    )
    vae.save_pretrained(folder / "vae")
    text = CLIPTextConfig(
        vocab_size=514,
        hidden_size=24,
        intermediate_size=24,
        num_hidden_layers=2,
        num_attention_heads=2,
        bos_token_id=512,
        eos_token_id=513,
        pad_token_id=513,
    )
    CLIPTextModel(text).save_pretrained(folder / "text_encoder")
    write_clip_tokenizer(folder / "tokenizer")
    return folder


@pytest.fixture(scope="session")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_base(tmp_path_factory.mktemp("sd15"))


def clip(seed: int = 0, frames: int = 2, views: int = 3, size: tuple[int, int] = (56, 104), **changed: Any) -> Any:
    """A training clip of random smooth images, and maps that show a part of them."""
    from pskel.train.clip import Clip

    random = np.random.default_rng(seed)
    height, width = size
    coarse = random.integers(0, 256, (frames, views, 3, 4, 4)).astype(np.float32)
    images = torch.nn.functional.interpolate(torch.tensor(coarse).flatten(0, 1), size=size, mode="bilinear")
    images = images.view(frames, views, 3, height, width).to(torch.uint8)
    is_point = torch.tensor(random.random((frames, views, 1, height, width)) < 0.5)
    bins = random.integers(1, 257, (frames, views, height, width)) * is_point[:, :, 0].numpy()
    poses = np.eye(4)[None, None, :3].repeat(frames, 0).repeat(views, 1) + random.normal(0, 0.3, (frames, views, 3, 4))
    fractions = random.uniform(0.4, 0.8, (frames, views, 4))
    action = np.array([[0.0, 0.0, 0.0]] + [[1.0 + 0.1 * i, 0.02, 0.01 * i] for i in range(1, frames)], np.float32)
    values: dict[str, Any] = {
        "color": images * is_point,
        "bins": torch.tensor(bins.astype(np.int16)),
        "boxes": torch.tensor(random.integers(0, 256, images.shape).astype(np.uint8)),
        "map": torch.tensor(random.integers(0, 256, images.shape).astype(np.uint8)),
        "images": images,
        "cameras": torch.tensor(np.concatenate([poses.reshape(frames, views, 12), fractions], -1).astype(np.float32)),
        "action": torch.tensor(action),
        "global_from_ego": torch.eye(4, dtype=torch.float64).repeat(frames, 1, 1),
        "t_us": torch.arange(frames) * 500_000,
        "original_sizes": torch.tensor([[900, 1600]] * views),
        "names": CAMERAS[:views],
        "captions": tuple(tuple(f"camera {view}" if view else "" for view in range(views)) for _ in range(frames)),
        "log": "log-a",
        "frame": seed,
        "hz": 2.0,
        "recipe": RECIPE,
    }
    return Clip(**{**values, **changed})


def random_weights(network: Any, seed: int = 0, scale: float = 0.1) -> None:
    """Give the trained weights that are 0 before training random values."""
    generator = torch.Generator().manual_seed(seed)
    for parameter in network.parameters():
        if parameter.requires_grad and not parameter.detach().any():
            parameter.data.copy_(scale * torch.randn(parameter.shape, generator=generator))
