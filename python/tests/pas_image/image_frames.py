"""Frames, messages and models that the tests of the image variant's denoiser share."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from image_base import CAMERAS, Array, Peer, random_weights, unpack
from pskel.models.pas_image import Denoiser, FrameCondition, Models, Rig
from pskel.models.pas_image.checkpoint import Training, create, header, saved_tensors
from pskel.models.pas_image.config import TINY, Config
from safetensors.torch import save_file

IMAGE_SIZES = [[1600, 900]] * 5 + [[800, 600]]
L, V, H, W = 2, 6, 40, 72  # latents of 5x9
SHAPE = (V, 4, H // 8, W // 8)
FPS = 2.0

HELLO = {
    "protocol": "pskel-denoiser",
    "version": "1",
    "window": str(L),
    "views": str(V),
    "condition_size": f"{H},{W}",
    "sampler": "ddim",
    "prediction": "epsilon",
    "fps": "2.0",
    "cameras": json.dumps(CAMERAS),
    "image_sizes": json.dumps(IMAGE_SIZES),
}


def write_weights(path: Path, base: Path, config: Config = TINY) -> Path:
    """Write weights of which all parts have an effect."""
    torch.manual_seed(8)
    network = create(config, base)
    random_weights(network)
    tensors = {name: tensor.contiguous() for name, tensor in saved_tensors(network.state_dict(), config).items()}
    save_file(tensors, path, header(config, Training(2, (224, 400), FPS)))
    return path


@pytest.fixture(scope="session")
def weights(base: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_weights(tmp_path_factory.mktemp("weights") / "weights.safetensors", base)


@pytest.fixture(scope="session")
def models(base: Path, weights: Path) -> Models:
    return Models.load(weights, base, dtype=torch.float32, device="cpu")


@pytest.fixture(scope="session")
def rig() -> Rig:
    return Rig(CAMERAS, tuple((width, height) for width, height in IMAGE_SIZES), FPS)


@pytest.fixture
def denoiser(models: Models, rig: Rig) -> Denoiser:
    return Denoiser(models, rig)


def arguments(base: Path, weights: Path, **changed: str) -> list[str]:
    options = {"weights": str(weights), "base": str(base), "device": "cpu", "dtype": "f32", **changed}
    return [text for name, value in options.items() for text in (f"--{name.replace('_', '-')}", value)]


@pytest.fixture(scope="session")
def peer(base: Path, weights: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Peer]:
    errors = tmp_path_factory.mktemp("peer") / "errors.txt"
    peer = Peer(arguments(base, weights), errors, "pskel.models.pas_image")
    texts, tensors = unpack(peer.ask(HELLO, {}))
    assert texts == {
        "protocol": "pskel-denoiser",
        "version": "1",
        "latent_shape": "6,4,5,9",
        "dtype": "F32",
        "image_size": "40,72",
        "guidance": "true",
        "frames": "true",
    }
    assert not tensors
    yield peer
    assert peer.close() == 0
    # Nothing but the notice about inputs that differ from the training.
    assert peer.errors.read_text() == (
        "pskel.models.pas_image: the weights were trained with 2 frames of 224x400 at 2 per second, "
        "found 2 frames of 40x72 at 2 per second\n"
    )


def condition_arrays(index: int, views: int = V, size: tuple[int, int] = (H, W)) -> dict[str, Any]:
    """Arrays of frame ``index`` as in the protocol, in the order of CAMERAS."""
    random = np.random.default_rng(index)
    points = random.random((views, 20, *size), np.float32)
    points[:, 3][random.random((views, *size)) < 0.5] = -1.0
    pose = np.eye(4)[None, :3].repeat(views, 0) + random.normal(0.0, 0.3, (views, 3, 4))
    fractions = random.uniform(0.4, 0.8, (views, 4))
    return {
        "points": points,
        "layout": random.random((views, 6, *size), np.float32),
        "action": np.array([0.8 + 0.1 * index, 0.02, 0.01 * index], np.float32),
        "cameras": np.concatenate([pose.reshape(views, 12), fractions], axis=1).astype(np.float32),
        "prompt": "Sunny. A driving scene in Boston" if index % 2 else "Rain",
    }


def window(first: int = 0) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
    """Latents, timesteps, sigmas and conditions of a window."""
    latents = np.random.default_rng(100 + first).normal(size=(L, *SHAPE)).astype(np.float32)
    timesteps, sigmas = np.array([151.0, 701.0], np.float32), np.array([0.4, 0.9], np.float32)
    return latents, timesteps, sigmas, [condition_arrays(first + i) for i in range(L)]


def created(frames: list[dict[str, Any]], references: list[bool] | None = None) -> list[FrameCondition]:
    marks = [False] * len(frames) if references is None else references
    return [FrameCondition.create(**frame, is_reference=mark) for frame, mark in zip(frames, marks)]


def request(
    latents: Array,
    timesteps: Array,
    sigmas: Array,
    frames: list[dict[str, Any]],
    references: list[bool] | None = None,
    call: int = 0,
) -> tuple[dict[str, str], dict[str, Array]]:
    """The message of a call."""
    names = ("points", "layout", "action", "cameras")
    texts = {"ask": "predict", "call": str(call), "prompts": json.dumps([frame["prompt"] for frame in frames])}
    if references is not None:
        texts["references"] = json.dumps(references)
    maps = {name: np.stack([frame[name] for frame in frames]) for name in names}
    return texts, {"latents": latents, "timesteps": timesteps, "sigmas": sigmas, **maps}
