"""Runs of the training command: a drive is learned and rolled out in closed loop, and 8-bit moments resume."""

import csv
import json
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("accelerate")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
safetensors = pytest.importorskip("safetensors.torch")
from pas_base import Array, write_base  # noqa: E402
from pas_clips import write_sizes  # noqa: E402
from pas_drives import CAMERAS, HZ, RECIPE, SIZE, Drive, drive, fit_codec, psnr, write_drive  # noqa: E402
from pas_rolls import roll_out  # noqa: E402
from pskel.models.pas import Config, Denoiser, Models, Rig  # noqa: E402
from pskel.models.pas.task import PasTask, task  # noqa: E402
from pskel.train.__main__ import main  # noqa: E402
from pskel.train.config import DataOptions, TrainOptions  # noqa: E402
from pskel.train.data.sampling import Sampler  # noqa: E402
from pskel.train.data.sources import open_data  # noqa: E402
from pskel.train.parallel import Processes  # noqa: E402

WINDOW, INFER_STEPS, DRIVEN = 3, 6, 20
FRAMES = WINDOW - 1 + DRIVEN + WINDOW - 1
"""References, driven frames, and forecasts of the last one."""
STEPS = 300


@pytest.fixture(autouse=True)
def one_thread() -> Any:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Drive]:
    """A folder with a drive, the base models and the sizes of the network."""
    folder, of = tmp_path_factory.mktemp("drive"), drive(FRAMES)
    write_drive(folder / "drive.safetensors", of)
    write_base(folder / "base")
    write_sizes(folder / "sizes.json")
    return folder, of


def train(folder: Path, out: Path, *more: str, **options: Any) -> None:
    """Run the command; ``options`` go into ``[train]``."""
    document = {
        "network": "pas",
        "train": {"learning_rate": 2e-3, "validate": 0, **options},
        "data": {"frames": WINDOW, "recipe": RECIPE},
        "pas": network_options(folder),
    }
    config = folder / f"{out.name}.json"
    config.write_text(json.dumps(document))
    assert main([str(config), "--data", str(folder / "drive.safetensors"), "--out", str(out), *more]) == 0


def network_options(folder: Path, **more: str) -> dict[str, Any]:
    return {"base": str(folder / "base"), "config": str(folder / "sizes.json"), **more}


def column(out: Path, name: str) -> list[float]:
    with open(out / "loss.csv", newline="") as file:
        return [float(row[name]) for row in csv.DictReader(file)]


def test_a_drive_is_overfitted_and_driven(recorded: tuple[Path, Drive], tmp_path: Path) -> None:
    """The loss with fixed draws falls to a tenth; 20 frames of Reset-and-Roll after 2 references are near the recorded."""
    folder, of = recorded
    begin = time.perf_counter()
    fit_codec(folder / "base", of, 200)
    fitted = time.perf_counter()
    out = tmp_path / "out"
    train(folder, out, steps=STEPS, checkpoint=STEPS, schedule="cosine", warmup=10)
    trained = time.perf_counter()

    torch.manual_seed(0)  # the seed of the training
    start = task(network_options(folder), TrainOptions())
    found = task(network_options(folder, weights=str(out / "weights.safetensors")), TrainOptions())
    first = loss_in(start, folder, step=0, number=0, seed=0)
    assert column(out, "network.loss")[0] == pytest.approx(first, rel=1e-5)
    before, after = (fixed_loss(each, folder) for each in (start, found))

    images = of.images.numpy()[WINDOW - 1 : WINDOW - 1 + DRIVEN]
    codec = start._codec
    decoded = codec.decode(codec.encode(torch.from_numpy(images).flatten(0, 1)))
    best = psnr(decoded.numpy().reshape(images.shape), images)
    driven = {name: roll(each, folder, of) for name, each in (("before", start), ("after", found))}
    scores = {name: [psnr(a, b) for a, b in zip(frames, images)] for name, frames in driven.items()}
    mean = {name: psnr(frames, images) for name, frames in driven.items()}
    done = time.perf_counter()
    print(
        f"loss {before:.4f} -> {after:.4f} in {STEPS} steps; loop of {DRIVEN} frames {mean['before']:.2f} dB -> "
        f"{mean['after']:.2f} dB (worst frame {min(scores['after']):.2f} dB, autoencoder alone {best:.2f} dB); "
        f"seconds: autoencoder {fitted - begin:.0f}, training {trained - fitted:.0f}, loops and losses {done - trained:.0f}"
    )
    assert before > 1.0 and after < 0.1 * before
    assert mean["after"] > 20.0 and mean["after"] > mean["before"] + 8.0
    assert min(scores["after"]) > max(scores["before"]) + 3.0
    # Each frame is nearest to its own recorded image, or that before or after it.
    for number, frame in enumerate(driven["after"]):
        nearest = int(np.argmin([np.square(frame - image).mean() for image in images]))
        assert abs(nearest - number) <= 1


def loss_in(of: PasTask, folder: Path, *, step: int, number: int, seed: int) -> float:
    """Loss of a training clip, by number, with the draws of a step."""
    data = open_data([str(folder / "drive.safetensors")], DataOptions(frames=WINDOW), None, Processes(), print)
    drawn = of.draw([Sampler(data.train, data.shares, 0).draw(number).clip], step, seed, 0)
    of.network.train()
    with torch.no_grad():
        return float(of.loss("network", drawn, {"network": of.network}, torch.device("cpu"))[0])


def fixed_loss(of: PasTask, folder: Path) -> float:
    """Mean loss of 12 clips with draws of another seed."""
    return float(np.mean([loss_in(of, folder, step=number, number=number, seed=1) for number in range(12)]))


def roll(of: PasTask, folder: Path, along: Drive) -> list[Array]:
    """Images ``float32 [V, 3, H, W]`` of a closed loop, without guidance."""
    models = Models(of.network.network.eval(), of._codec, of._text)
    denoiser = Denoiser(models, Rig(CAMERAS, (SIZE[::-1],) * len(CAMERAS), HZ))
    references = [denoiser.encode(image) for image in along.images[: WINDOW - 1].numpy()]
    random = np.random.default_rng(4)
    shape = denoiser.latent_shape(SIZE)
    noise = [[random.normal(size=shape).astype(np.float32) for _ in range(WINDOW)] for _ in range(DRIVEN)]
    conditions = [along.condition(frame) for frame in range(FRAMES)]
    return [denoiser.decode(frame) for frame in roll_out(denoiser, references, conditions, noise, 1.0, INFER_STEPS)]


@pytest.mark.parametrize("precision", ["f32", "bf16"])
def test_8_bit_moments_resume_with_the_same_bits(recorded: tuple[Path, Drive], tmp_path: Path, precision: str) -> None:
    """Two runs of 2 steps have the losses and weights of one run of 4. Without its moments, the second run differs."""
    folder, _ = recorded
    options = {"steps": 4, "checkpoint": 2, "optimizer": "adamw8bit", "precision": precision}
    whole, parts, other = (tmp_path / f"{name}-{precision}" for name in ("whole", "parts", "other"))
    train(folder, whole, **options)
    train(folder, parts, "--steps", "2", **options)
    shutil.copytree(parts, other)
    train(folder, parts, "--resume", **options)
    assert (parts / "loss.csv").read_bytes() == (whole / "loss.csv").read_bytes()
    assert same_weights(parts, whole) and len(set(column(whole, "network.loss"))) == 4

    file = other / "checkpoint-2" / "rank-0.pt"
    state = torch.load(file, weights_only=True)
    moments = state["moments"]["network"]
    large = [each for each in moments if "first_scale" in each]
    assert len(large) > 20 and {each["second"].dtype for each in large} == {torch.uint8}
    assert all(("master" in each) == (precision == "bf16") for each in moments if each)
    for each in large:
        each["second_scale"].zero_()
    torch.save(state, file)
    train(folder, other, "--resume", **options)
    found, expected = column(other, "network.loss"), column(whole, "network.loss")
    assert found[:3] == expected[:3] and found[3] != expected[3]  # the third step begins with the same weights
    assert not same_weights(other, whole)


def same_weights(one: Path, other: Path) -> bool:
    first, second = (safetensors.load_file(out / "weights.safetensors") for out in (one, other))
    assert first.keys() == second.keys()
    assert all(tensor.dtype is second[name].dtype for name, tensor in first.items())
    return all(torch.equal(tensor, second[name]) for name, tensor in first.items())
