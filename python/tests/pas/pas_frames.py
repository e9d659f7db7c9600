"""Frames, messages and models that the tests of the video network's denoiser share."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from pas_base import Array, Peer, unpack, write_base
from pskel.models.pas import Config, Denoiser, FrameCondition, Models, Rig

SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
FIXTURE = Path(os.environ.get("PSKEL_FIXTURES", SHARED / "fixtures")) / "pas-network"
needs_fixture = pytest.mark.skipif(not FIXTURE.exists(), reason="pas-network is not there (set PSKEL_SHARED)")

CAMERAS = ["CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT"]
TRAINED = [5, 0, 1, 2, 3, 4]  # FL F FR BR B BL
IMAGE_SIZES = [[1600, 900]] * 5 + [[800, 600]]
L, V, H, W = 3, 6, 32, 64
SHAPE = (V, 16, H // 8, W // 8)
FPS = 6.0

HELLO = {
    "protocol": "pskel-denoiser",
    "version": "1",
    "window": str(L),
    "views": str(V),
    "condition_size": f"{H},{W}",
    "sampler": "flow_match",
    "prediction": "velocity",
    "fps": "6.0",
    "cameras": json.dumps(CAMERAS),
    "image_sizes": json.dumps(IMAGE_SIZES),
}


@pytest.fixture(scope="session")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_base(tmp_path_factory.mktemp("base"))


@pytest.fixture(scope="session")
def models(base: Path) -> Models:
    config = Config.read(FIXTURE / "config.json")
    return Models.load(FIXTURE / "weights.safetensors", base, config, dtype=torch.float32, device="cpu")


@pytest.fixture(scope="session")
def rig() -> Rig:
    return Rig(tuple(CAMERAS), tuple((width, height) for width, height in IMAGE_SIZES), FPS)


@pytest.fixture
def denoiser(models: Models, rig: Rig) -> Denoiser:
    return Denoiser(models, rig)


def arguments(base: Path, **changed: str) -> list[str]:
    weights, config = str(FIXTURE / "weights.safetensors"), str(FIXTURE / "config.json")
    options = {"weights": weights, "base": str(base), "config": config, "device": "cpu", "dtype": "f32", **changed}
    return [text for name, value in options.items() for text in (f"--{name}", value)]


@pytest.fixture(scope="session")
def peer(base: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Peer]:
    peer = Peer(arguments(base), tmp_path_factory.mktemp("peer") / "errors.txt")
    texts, tensors = unpack(peer.ask(HELLO, {}))
    assert texts == {
        "protocol": "pskel-denoiser",
        "version": "1",
        "latent_shape": "6,16,4,8",
        "dtype": "F32",
        "image_size": "32,64",
        "guidance": "true",
        "frames": "true",
    }
    assert not tensors
    yield peer
    assert peer.close() == 0
    # Nothing but the notice about inputs that differ from the training.
    assert peer.errors.read_text() == (
        "pskel.models.pas: the published nuScenes checkpoint was trained with 12 frames of 256x448 at 6 per second, "
        "found 3 frames of 32x64 at 6 per second\n"
    )


def condition_arrays(index: int) -> dict[str, Any]:
    """Arrays of frame ``index`` as in the protocol, in the order of CAMERAS."""
    random = np.random.default_rng(index)
    points = random.random((V, 20, H, W), np.float32)
    points[:, 3][random.random((V, H, W)) < 0.5] = -1.0
    pose = np.eye(4)[None, :3].repeat(V, 0) + random.normal(0.0, 0.3, (V, 3, 4))
    fractions = random.uniform(0.4, 0.8, (V, 4))
    return {
        "points": points,
        "layout": random.random((V, 6, H, W), np.float32),
        "action": np.array([0.8 + 0.1 * index, 0.02, 0.01 * index], np.float32),
        "cameras": np.concatenate([pose.reshape(V, 12), fractions], axis=1).astype(np.float32),
        "prompt": "Sunny. A driving scene in Boston" if index % 2 else "Rain",
    }


def condition(index: int) -> FrameCondition:
    return FrameCondition.create(**condition_arrays(index))


def window(first: int = 0) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
    """Latents, timesteps, sigmas and conditions of a window."""
    sigmas = np.array([0.1, 0.5, 0.9], np.float32)
    latents = np.random.default_rng(100 + first).normal(size=(L, *SHAPE)).astype(np.float32)
    return latents, sigmas * 1000, sigmas, [condition_arrays(first + i) for i in range(L)]


def dropped(arrays: dict[str, Any]) -> dict[str, Any]:
    """Values of docs/src/reference/denoiser.md for the unconditional half."""
    layout, action = np.full_like(arrays["layout"], 0.1255), np.full_like(arrays["action"], -1000.0)
    return {**arrays, "layout": layout, "action": action, "prompt": ""}


def request(
    latents: Array, timesteps: Array, sigmas: Array, frames: list[dict[str, Any]], call: int = 0
) -> tuple[dict[str, str], dict[str, Array]]:
    """The message of a call."""
    names = ("points", "layout", "action", "cameras")
    texts = {"ask": "predict", "call": str(call), "prompts": json.dumps([frame["prompt"] for frame in frames])}
    maps = {name: np.stack([frame[name] for frame in frames]) for name in names}
    return texts, {"latents": latents, "timesteps": timesteps, "sigmas": sigmas, **maps}
