"""The training step equals the authors', in all cases of the fixture."""

import os
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("safetensors")
SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
FIXTURES = Path(os.environ.get("PSKEL_FIXTURES", SHARED / "fixtures"))
if not (FIXTURES / "pas-train").exists():
    pytest.skip("pas-train is not there (set PSKEL_SHARED)", allow_module_level=True)

from diffusers import AutoencoderKL  # noqa: E402
from pas_steps import (  # noqa: E402
    STEPS,
    Case,
    batch_of,
    draws_of,
    network_of,
    read_case,
    read_meta,
    step_of,
    texts_of,
)
from pskel.models.pas.training.step import loss_of, noisy_inputs, sigmas_of  # noqa: E402
from pskel.models.pas.vae import ImageCodec  # noqa: E402
from safetensors.torch import load_file  # noqa: E402

CASES = list(read_meta()["cases"])
SHIFT, SCALE = 0.0609, 1.5305


def rms(tensor: Any) -> float:
    return float(tensor.double().square().mean().sqrt())


def error(found: Any, expected: Any) -> float:
    """Maximum error over the RMS of the expected values."""
    assert found.shape == expected.shape
    return float((found.detach().double() - expected.double()).abs().max()) / rms(expected)


@pytest.fixture(scope="module")
def codec() -> ImageCodec:
    vae = AutoencoderKL(**read_meta()["vae"])
    loaded = vae.load_state_dict(load_file(STEPS / "vae.safetensors"), strict=False)
    assert not loaded.unexpected_keys and all(name.startswith("decoder.") for name in loaded.missing_keys)
    return ImageCodec(vae)


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return read_case(request.param)


def latents_of(case: Case, codec: ImageCodec, step: dict[str, Any]) -> Any:
    images = case.batch["images"]
    if "posterior_mean" in step:
        moments = codec.posterior(images.flatten(0, 2) / 255.0)
        for name, found in zip(("mean", "std"), moments):
            assert error(found.view(*images.shape[:3], *found.shape[1:]), step[f"posterior_{name}"]) < 1e-5
    return codec.sample(images, step["draw.posterior_noise"], at_once=4)


def test_there_are_all_kinds_of_cases() -> None:
    assert {"nuscenes", "nuplan.points", "nuplan.layout"} < set(CASES) and len(CASES) == 11
    assert {name.partition(".")[2] for name in CASES if name.startswith("dropouts")} == {
        *("text", "boxes", "map", "action", "depth", "color", "single_frames", "all")
    }


def test_inputs_equal_the_authors(case: Case, codec: ImageCodec) -> None:
    assert (codec.shift, codec.scale) == (SHIFT, SCALE)
    batch = batch_of(case)
    for index in range(case.meta["steps"]):
        step = step_of(case, index)
        draws = draws_of(step)
        latents = latents_of(case, codec, step)
        inputs, targets = noisy_inputs(batch, texts_of(case), latents, draws, case.options)
        errors = {
            "sample": error(inputs.sample, step["sample"]),
            "timestep": error(inputs.timestep, step["timestep"]),
            "sigma": error(targets.sigma, step["sigma"]),
            "pooled": error(inputs.pooled, step["pooled_projections"]),
        }
        probed = {"image": inputs.layout}
        if inputs.points is not None:
            probed |= {"clr": inputs.points[:, :, :, :3], "depth": inputs.points[:, :, :, 3:]}
        for name, maps in probed.items():
            assert torch.equal(maps[..., 5, 7], step[f"probe_condition_{name}_tensor"]), name
        if "latents" in step:
            errors["latents"] = error(latents, step["latents"])
            assert torch.equal(inputs.text, step["encoder_hidden_states"])
        assert max(errors.values()) < 1e-5, errors
        assert float((inputs.ids - step["added_time_ids"]).abs().max()) < 1e-4
        assert torch.equal(inputs.single_frames, step["single_frames"].bool())
        assert torch.equal(targets.sample, inputs.sample)


def test_losses_and_gradients_equal_the_authors(case: Case, codec: ImageCodec) -> None:
    batch, network = batch_of(case), network_of()
    rate = case.meta["learning_rate"]
    optimizer = torch.optim.AdamW(network.parameters(), lr=rate)
    for index in range(case.meta["steps"]):
        step = step_of(case, index)
        latents = latents_of(case, codec, step)
        inputs, targets = noisy_inputs(batch, texts_of(case), latents, draws_of(step), case.options)
        optimizer.zero_grad()
        velocity = network(inputs)
        loss = loss_of(velocity, targets)
        torch.autograd.backward(loss)
        assert error(velocity, step["prediction"]) < 1e-5
        assert loss.item() == pytest.approx(step["loss"].item(), rel=2e-6)
        assert loss.item() == pytest.approx(case.meta["losses"][index], rel=2e-6)
        expect_gradients(network, step, case)
        optimizer.step()
    expect_parameters(network, case, rate)


def expect_gradients(network: Any, step: dict[str, Any], case: Case) -> None:
    named = network.network.named_parameters()
    gradients = {name: parameter.grad for name, parameter in named if parameter.grad is not None}
    assert len(gradients) == case.meta["parameters"]
    for name, found in gradients.items():
        if f"grad.{name}" in step:
            expected = step[f"grad.{name}"]
            assert float((found - expected).abs().max()) <= 2e-4 * rms(expected), name
            continue
        scale = float(step[f"grad_norm.{name}"]) / found.numel() ** 0.5
        assert abs(rms(found) - scale) <= 2e-4 * scale, name
        assert float((sampled(found) - step[f"grad_sample.{name}"]).abs().max()) <= 2e-4 * scale, name


def sampled(tensor: Any) -> Any:
    """The entries of the fixture."""
    flat = tensor.flatten()
    return flat if len(flat) <= 64 else flat[torch.arange(64) * len(flat) // 64]


def expect_parameters(network: Any, case: Case, rate: float) -> None:
    """Parameters after all steps, within 0.03 learning rates, and 0.005 in RMS where all are known.

    Adam's first step is about `rate * sign(gradient)`: where the first gradient is within rounding of 0 (often as
    small as Adam's epsilon), rounding decides it, and only the RMS is compared.
    """
    part = case.name.partition(".")[2]
    prefix = f"{part}." if case.file != "nuscenes" else ""
    whole, samples = f"{prefix}after.", f"{prefix}after_sample."
    first, known = step_of(case, 0), 0
    for name, parameter in network.network.named_parameters():
        if whole + name in case.tensors:
            difference = (parameter - case.tensors[whole + name]).detach() / rate
            assert rms(difference) < 0.005, name
            expect_close(difference, first[f"grad.{name}"], name)
            known += 1
        elif samples + name in case.tensors:
            found = sampled(parameter.detach())
            gradient = sampled(first[f"grad.{name}"]) if f"grad.{name}" in first else first[f"grad_sample.{name}"]
            expect_close((found - case.tensors[samples + name]) / rate, gradient, name)
            root = parameter.numel() ** 0.5
            norm = float(case.tensors[f"{prefix}after_norm.{name}"])
            assert abs(float(parameter.detach().double().norm()) - norm) < 0.05 * rate * root, name
            known += 1
    assert known == (284 if case.name in ("nuscenes", "nuplan.points") else 0)


def expect_close(difference: Any, gradient: Any, name: str) -> None:
    """Expects differences of 0.03 learning rates at most where a first gradient is 0 or surely not: nearly everywhere."""
    sure = (gradient == 0) | (gradient.abs() > 2e-5 * rms(gradient))
    assert float(sure.double().mean()) > 0.95, name
    assert float((difference * sure).abs().max()) < 0.03, name


def test_levels_are_of_the_table() -> None:
    """By hand: sigma = 3 s / (1 + 2 s), s = 1 - i / 1000, where i is the integer part of 1000 / (1 + exp(-n))."""
    normal = [-1.6448536, -0.6744898, 0.0, 0.6744898, 1.6448536]
    expected = [3 * s / (1 + 2 * s) for s in (1 - i / 1000 for i in (161, 337, 500, 662, 838))]
    assert sigmas_of(torch.tensor(normal)).tolist() == pytest.approx(expected, rel=1e-6)
    # Level 999 is the last one.
    assert sigmas_of(torch.tensor([-100.0, 100.0])).tolist() == pytest.approx([1.0, 0.003 / 1.002], rel=1e-6)
