"""A clip is learned by heart, then driven in a closed loop with Reset-and-Roll."""

import json
import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
pytest.importorskip("transformers")
from image_base import Array, Peer, clip, unpack, write_base  # noqa: E402
from image_frames import HELLO, arguments  # noqa: E402
from image_rollout import roll_out, run_loop, through  # noqa: E402
from image_steps import CPU, SIZE, VIEWS, modules, prepared, steps  # noqa: E402
from pskel.models.pas_image import Denoiser, FrameCondition, Models, Rig  # noqa: E402
from pskel.models.pas_image.task import ImageTask  # noqa: E402
from safetensors.torch import save_file  # noqa: E402

CLIP = clip(views=VIEWS, size=SIZE)
"""A recording of two frames that repeats."""
PER_FRAME = ("color", "bins", "boxes", "map", "images", "cameras")
REPEATED = replace(CLIP, captions=CLIP.captions[::-1], **{name: getattr(CLIP, name).flip(0) for name in PER_FRAME})
"""The window from the second frame to the repeated first."""
COUNT, STEPS, SHORT, FEW_STEPS, GUIDANCE = 20, 10, 8, 4, 2.0


def write_fitted_base(folder: Path) -> Path:
    """Write a base whose autoencoder reproduces the images of the clip, with latents of variance 1."""
    path = write_base(folder) / "vae"
    torch.manual_seed(2)
    vae = diffusers.AutoencoderKL.from_pretrained(path).train()
    images = CLIP.images.flatten(0, 1).float() / 127.5 - 1.0
    count, rate = 200, 1e-2
    optimizer = torch.optim.AdamW(vae.parameters(), lr=rate, weight_decay=0.0)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=count)
    for _ in range(count):
        z = vae.encode(images).latent_dist.mean
        decoded = vae.decode(z + 0.3 * torch.randn_like(z)).sample  # so that small errors of latents remain small
        optimizer.zero_grad()
        torch.autograd.backward((decoded - images).square().mean() + 1e-4 * z.square().mean())
        optimizer.step()
        schedule.step()
    vae.eval().requires_grad_(False)
    channels = vae.config.latent_channels
    vae.quant_conv.weight[channels:] = 0.0
    vae.quant_conv.bias[channels:] = -8.0  # logarithm of the variance of the posterior
    vae.register_to_config(scaling_factor=1.0 / float(vae.encode(images).latent_dist.mean.std()))
    vae.save_pretrained(path)
    return folder


class Learned(NamedTuple):
    """A training on the clip."""

    task: ImageTask
    before: float
    after: float
    weights: Path


def fixed_loss(made: ImageTask) -> float:
    """Mean loss over draws that the training has not seen."""
    with torch.no_grad():
        batches = [made.draw([CLIP, REPEATED] * 2, number, 12345, 0) for number in range(8)]
        losses = [float(made.loss("network", batch, modules(made), CPU)[0]) for batch in batches]
    return math.fsum(losses) / len(losses)


@pytest.fixture(scope="module")
def fitted_base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_fitted_base(tmp_path_factory.mktemp("sd15"))


@pytest.fixture(scope="module")
def learned(fitted_base: Path, tmp_path_factory: pytest.TempPathFactory) -> Learned:
    begin = time.process_time()
    made = prepared(fitted_base, infer_steps=FEW_STEPS)
    before = fixed_loss(made)
    count, rate, warmup = 250, 4e-3, 20
    optimizer = torch.optim.AdamW(made.players[0].groups, lr=rate, weight_decay=0.0)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda n: min(1.0, (n + 1) / warmup) * (1.0 - n / count))
    for number in range(count):
        steps(made, optimizer, range(number, number + 1), [CLIP, REPEATED] * 4)
        schedule.step()
    made.network.eval()
    path = tmp_path_factory.mktemp("learned") / "weights.safetensors"
    tensors, texts = made.weights(modules(made))
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path, texts)
    after = fixed_loss(made)
    print(f"loss {before:.3f} before, {after:.4f} after {count} steps in {time.process_time() - begin:.0f} s")
    return Learned(made, before, after, path)


def test_a_clip_is_learned_by_heart(learned: Learned) -> None:
    assert learned.before > 0.9  # the noise has a variance of 1
    assert learned.after < 0.1 * learned.before, learned


def test_held_out_clips_are_scored_and_shown(learned: Learned) -> None:
    with torch.no_grad():
        scores, again = (learned.task.scores(CLIP, modules(learned.task)) for _ in range(2))
        pictures = learned.task.pictures(CLIP, modules(learned.task))
    assert scores == again and set(scores) == {"loss", "psnr_db"} and scores["loss"] < 0.3
    assert pictures.dtype is torch.uint8 and pictures.shape == (4, 3, 32, VIEWS * 56)
    assert torch.equal(pictures[3], torch.cat(list(CLIP.images[-1]), dim=-1))
    assert torch.equal(pictures[0], torch.cat(list(CLIP.color[-1]), dim=-1))
    error = (pictures[2].float() - pictures[3].float()).square().mean() / 255**2
    assert scores["psnr_db"] == pytest.approx(-10 * math.log10(float(error)), abs=0.1)


def condition(number: int) -> FrameCondition:
    """Conditions of a frame in the closed loop: the learned clip's, in turn."""
    frame = number % 2
    bins = CLIP.bins[frame].numpy().astype(np.float32)
    depth = np.where(bins == 0, -1.0, np.minimum(bins, 255) / 255)[:, None]
    points = np.concatenate([CLIP.color[frame].numpy() / 255, depth], axis=1).astype(np.float32)
    layout = torch.cat([CLIP.boxes[frame], CLIP.map[frame]], dim=1).numpy() / 255
    motion, cameras = CLIP.action[1].numpy(), CLIP.cameras[frame].numpy()
    return FrameCondition.create(points, layout, motion, cameras, CLIP.captions[frame])


RIG = Rig(CLIP.names, ((1600, 900),) * VIEWS, CLIP.hz)


@pytest.fixture(scope="module")
def models(learned: Learned, fitted_base: Path) -> Models:
    return Models.load(learned.weights, fitted_base, dtype=torch.float32, device="cpu")


@pytest.fixture(scope="module")
def denoiser(models: Models) -> Denoiser:
    return Denoiser(models, RIG)


@pytest.fixture(scope="module")
def new_denoiser(models: Models, fitted_base: Path) -> Denoiser:
    """Of a network before its training."""
    return Denoiser(replace(models, network=prepared(fitted_base).network.eval()), RIG)


@pytest.fixture(scope="module")
def peer(learned: Learned, fitted_base: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Peer]:
    errors = tmp_path_factory.mktemp("peer") / "errors.txt"
    peer = Peer(arguments(fitted_base, learned.weights), errors, "pskel.models.pas_image")
    changed = {
        "views": str(VIEWS),
        "condition_size": "32,56",
        "cameras": json.dumps(CLIP.names),
        "image_sizes": json.dumps([[1600, 900]] * VIEWS),
    }
    assert unpack(peer.ask({**HELLO, **changed}, {}))[0]["latent_shape"] == f"{VIEWS},4,4,7"
    yield peer
    assert peer.close() == 0
    assert peer.errors.read_text() == ""  # the inputs are those of the training


def reference(denoiser: Denoiser) -> Array:
    return denoiser.encode(CLIP.images[0].numpy() / 255)


def fixed_noise(shape: tuple[int, ...]) -> list[list[Array]]:
    random = np.random.default_rng(6)
    return [[random.normal(size=shape).astype(np.float32) for _ in range(2)] for _ in range(COUNT)]


def drive(denoiser: Denoiser, network: Any, count: int, infer_steps: int) -> list[Array]:
    """Latents of a closed loop of ``count`` steps after the first frame of the clip."""
    first = reference(denoiser)
    conditions = [condition(number) for number in range(count + 3)]
    return roll_out(network, first, conditions, fixed_noise(first.shape)[:count], infer_steps, GUIDANCE)


def square_errors(denoiser: Denoiser, frames: list[Array], offset: int) -> Array:
    """Mean square errors of decoded frames, to the recorded image with the number of the frame plus ``offset``."""
    recorded = CLIP.images.numpy() / 255
    images = [denoiser.decode(frame) for frame in frames]
    errors = [np.square(image - recorded[(1 + i + offset) % 2]).mean() for i, image in enumerate(images)]
    return np.array(errors, np.float32)


def test_the_learned_clip_is_driven(denoiser: Denoiser, new_denoiser: Denoiser) -> None:
    """A closed loop of 20 steps shows the recorded images, as far as the autoencoder does."""
    recorded = [denoiser.encode(image) for image in CLIP.images.numpy() / 255]
    assert square_errors(denoiser, recorded, 1).max() < 0.06**2  # the autoencoder alone
    frames = drive(denoiser, denoiser, COUNT, STEPS)
    before = square_errors(denoiser, drive(new_denoiser, new_denoiser, 2, STEPS), 0).mean()
    own, other = (square_errors(denoiser, frames, offset) for offset in (0, 1))
    decibels = [-10 * math.log10(float(error)) for error in (before, own.mean(), own.max(), other.mean())]
    print("PSNR {:.1f} dB before, {:.1f} dB after, worst {:.1f} dB; to the other frame {:.1f} dB".format(*decibels))
    assert len(frames) == COUNT and np.isfinite(np.stack(frames)).all()
    assert own.mean() < before / 5 and own.max() < before
    assert (own < other).all() and own.mean() < other.mean() / 5  # frames follow their conditions


def test_another_process_drives_the_same(denoiser: Denoiser, peer: Peer) -> None:
    ours = drive(denoiser, denoiser, SHORT, FEW_STEPS)
    theirs = drive(denoiser, through(peer), SHORT, FEW_STEPS)
    assert len(ours) == len(theirs) == SHORT
    for frame, other in zip(ours, theirs):
        np.testing.assert_array_equal(frame, other)
    assert square_errors(denoiser, ours, 0).mean() < square_errors(denoiser, ours, 1).mean() / 5


def test_the_loop_of_the_package_gives_the_same(denoiser: Denoiser) -> None:
    pytest.importorskip("pskel._pskel")
    first = reference(denoiser)
    # A network that finds no noise shows the noise of the loop: a new frame is last in the first call of a roll.
    seen: list[Array] = []

    def still(latents: Array, timesteps: Array, sigmas: Array, _: list[FrameCondition]) -> Array:
        if timesteps[-1] == 751.0:  # the first of four steps
            seen.append(latents[-1].copy())
        return np.zeros_like(latents)

    run_loop(still, first, condition, SHORT, FEW_STEPS, 1.0)
    assert len(seen) == SHORT * 2
    noise = [seen[2 * step : 2 * step + 2] for step in range(SHORT)]
    conditions = [condition(i) for i in range(SHORT + 3)]
    expected = roll_out(denoiser, first, conditions, noise, FEW_STEPS, GUIDANCE)
    found = run_loop(denoiser, first, condition, SHORT, FEW_STEPS, GUIDANCE)
    assert len(found) == SHORT
    for ours, packaged in zip(expected, found):
        np.testing.assert_array_equal(ours, packaged)
    assert square_errors(denoiser, found, 0).mean() < square_errors(denoiser, found, 1).mean() / 5
