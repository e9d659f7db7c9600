"""Levels, targets and dropouts of the image variant's training step, by hand and by diffusers' schedulers."""

import math
import re
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
pytest.importorskip("transformers")
from dataclasses import replace  # noqa: E402

from image_base import CAMERAS, RECIPE, clip  # noqa: E402
from pskel.models._rig import Rig  # noqa: E402
from pskel.models.pas import added_time_ids  # noqa: E402
from pskel.models.pas_image.conditions import collate, point_channels, visible  # noqa: E402
from pskel.models.pas_image.config import TINY, Config  # noqa: E402
from pskel.models.pas_image.schedule import Schedule, inference_timesteps  # noqa: E402
from pskel.models.pas_image.step import (  # noqa: E402
    DROPPABLE,
    Draws,
    StepOptions,
    Targets,
    errors_of,
    levels_of,
    loss_of,
    noisy_inputs,
)

TABLE = {"beta_start": 0.00085, "beta_end": 0.012, "beta_schedule": "scaled_linear"}
LATENTS = (2, 3, 4, 7, 13)
NEVER = {f"drop_{part}": 0.0 for part in ("text", "boxes", "map", "action", "depth", "color")} | {"single_frames": 0.0}


def draws(seed: int = 0, clips: int = 2, **changed: Any) -> Draws:
    return Draws.sample(torch.Generator().manual_seed(seed), clips, LATENTS)._replace(**changed)


def test_the_table_is_the_one_of_stable_diffusion() -> None:
    betas = np.linspace(math.sqrt(0.00085), math.sqrt(0.012), 1000) ** 2
    table = Schedule().table.double().numpy()
    np.testing.assert_allclose(table, np.cumprod(1.0 - betas), rtol=2e-5)
    assert table[0] == pytest.approx(0.99915) and math.sqrt(table[999]) == pytest.approx(0.0683, abs=5e-5)


@pytest.mark.parametrize("zero_snr", [False, True])
def test_noise_and_targets_equal_diffusers(zero_snr: bool) -> None:
    scheduler = diffusers.DDPMScheduler(**TABLE, rescale_betas_zero_snr=zero_snr)
    schedule, given = Schedule(zero_snr), draws()
    latents, noise = given.posterior_noise, given.noise
    timesteps = torch.tensor([[0, 999], [137, 500]])
    each = timesteps[:, :, None].expand(2, 2, 3).flatten()
    flat = latents.flatten(0, 2), noise.flatten(0, 2), each
    assert torch.equal(schedule.noisy(latents, noise, timesteps).flatten(0, 2), scheduler.add_noise(*flat))
    assert torch.equal(
        schedule.target("velocity", latents, noise, timesteps).flatten(0, 2), scheduler.get_velocity(*flat)
    )
    assert torch.equal(schedule.target("epsilon", latents, noise, timesteps), noise)
    # By hand, in double precision.
    a = float(scheduler.alphas_cumprod[137])
    expected = math.sqrt(a) * latents[1, 0].double() + math.sqrt(1 - a) * noise[1, 0].double()
    assert (schedule.noisy(latents, noise, timesteps)[1, 0] - expected).abs().max() < 1e-6
    if zero_snr:  # the last step is noise alone
        assert torch.equal(schedule.noisy(latents, noise, timesteps)[0, 1], noise[0, 1])


@pytest.mark.parametrize("prediction", ["epsilon", "velocity"])
def test_inference_steps_equal_diffusers(prediction: Any) -> None:
    kind = {"epsilon": "epsilon", "velocity": "v_prediction"}[prediction]
    scheduler = diffusers.DDIMScheduler(
        **TABLE, steps_offset=1, set_alpha_to_one=False, clip_sample=False, prediction_type=kind
    )
    scheduler.set_timesteps(20)
    levels = inference_timesteps(20)
    assert levels == scheduler.timesteps.tolist() and levels[0] == 951 and levels[-1] == 1
    schedule, x, output = Schedule(), draws().noise[:1, :1], draws(1).noise[:1, :1]
    for level, after in zip(levels, [*levels[1:], 0]):
        now, then = torch.tensor([[level]]), torch.tensor([[after]])
        found = schedule.step(prediction, x, output, now, then)
        expected = scheduler.step(output, level, x).prev_sample
        assert (found - expected).abs().max() < 1e-5 * expected.std()
    assert inference_timesteps(4, zero_snr=True) == [999, 749, 499, 249]
    with pytest.raises(ValueError, match="expected inference steps of 1 to 1000, found 0"):
        inference_timesteps(0)


def test_levels_of_the_loop_have_the_same_noise() -> None:
    levels = [1.0, 51.0, 500.0, 951.0]
    assert Schedule().of_loop(levels).tolist() == levels
    zero = Schedule(zero_snr=True)
    found = zero.of_loop(levels).double().numpy()
    signals = zero.table.double().sqrt().numpy()
    expected = Schedule().table.double().sqrt().numpy()[np.array(levels, int)]
    np.testing.assert_allclose(np.interp(found, np.arange(1000), signals), expected, atol=1e-6)
    assert (found < levels).all() and found[0] > 0.5  # the whole table has less signal
    for wrong in (1000.0, -1.0, 3.5):
        with pytest.raises(ValueError, match=f"expected whole timesteps of 0 to 999, found {wrong:g}"):
            Schedule().of_loop([wrong])


def test_levels_by_hand() -> None:
    """Frame 0 of the first clip is the previous frame of a rollout; both frames of the second are free."""
    given = draws(level=torch.tensor([[0.5, 0.5], [0.5, 0.1234]]), previous=torch.tensor([0.49, 0.5]))
    timesteps, is_counted = levels_of(given, StepOptions())
    # 50 + floor(0.5 * 151), floor(0.5 * 1000); floor(1000 u) twice.
    assert timesteps.tolist() == [[125, 500], [500, 123]] and timesteps.dtype is torch.int64
    assert is_counted.tolist() == [[False, True], [True, True]]
    most = torch.full((2, 2), 1.0 - 2.0**-24)
    for uniform, expected in ((torch.zeros(2, 2), [[50, 0], [0, 0]]), (most, [[200, 999], [999, 999]])):
        assert levels_of(given._replace(level=uniform), StepOptions())[0].tolist() == expected
    longer = Draws.sample(torch.Generator().manual_seed(0), 1, (4, 1, 4, 1, 1))._replace(previous=torch.zeros(1))
    timesteps, is_counted = levels_of(longer, StepOptions(previous_from=7, previous_to=7))
    assert timesteps[0, :3].tolist() == [7, 7, 7] and is_counted.tolist() == [[False, False, False, True]]


def test_levels_are_uniform() -> None:
    count = 20_000
    given = Draws.sample(torch.Generator().manual_seed(3), count, (2, 1, 1, 1, 1))
    timesteps, is_counted = levels_of(given, StepOptions())
    previous = ~is_counted[:, 0]
    assert abs(float(previous.float().mean()) - 0.5) < 5 * 0.5 / math.sqrt(count)
    nearly_clean, free = timesteps[previous, 0].double(), timesteps[~previous].double()
    assert [float(x) for x in (nearly_clean.min(), nearly_clean.max(), free.min(), free.max())] == [50, 200, 0, 999]
    # Five standard errors of the means of uniform whole numbers.
    assert abs(nearly_clean.mean() - 125.0) < 5 * math.sqrt((151**2 - 1) / 12 / len(nearly_clean))
    assert abs(free.mean() - 499.5) < 5 * math.sqrt((1000**2 - 1) / 12 / free.numel())
    assert abs(float((given.text < 0.2).float().mean()) - 0.2) < 5 * math.sqrt(0.16 / count)


def test_draws_depend_on_the_generator_alone() -> None:
    first, second, other = draws(1), draws(1), draws(2)
    assert all(torch.equal(a, b) for a, b in zip(first, second))
    assert all((a != b).any() for a, b in zip(first, other))
    assert abs(float(first.noise.std()) - 1.0) < 0.1 and not torch.equal(first.noise, first.posterior_noise)


def made(part: str | None = None, config: Config = TINY) -> tuple[Any, Any, Any]:
    """Inputs and targets of two clips, of which the first is without a part; and their batch."""
    batch = collate([clip(0), clip(1)], config)
    text = torch.randn(len(batch.texts), 77, config.cross_attention_dim, generator=torch.Generator().manual_seed(4))
    never = torch.full((2,), 0.999)
    uniforms = {name: never for name in DROPPABLE}
    if part is not None:
        uniforms[part] = torch.tensor([0.0999, 0.999])
    given = draws(previous=torch.tensor([0.0, 0.9]), **uniforms)
    latents = draws(7).noise
    return *noisy_inputs(batch, text, latents, given, Schedule(config.zero_snr), config), (batch, text, latents, given)


def test_inputs_without_dropouts() -> None:
    found, targets, (batch, text, latents, given) = made()
    timesteps, is_counted = levels_of(given, StepOptions())
    assert torch.equal(found.sample, Schedule().noisy(latents, given.noise, timesteps))
    assert torch.equal(found.timestep, timesteps.float()) and torch.equal(targets.output, given.noise)
    assert torch.equal(targets.is_counted, is_counted)
    assert torch.equal(found.layout[:, :, :, :3], batch.boxes / 255.0)
    assert torch.equal(found.layout[:, :, :, 3:], batch.map / 255.0)
    assert torch.equal(found.points[:, :, :, :3], batch.color / 255.0)
    bins = batch.bins.double()
    depth = torch.where(bins == 0, -1.0, bins.clamp(max=255) / 255.0).float()
    assert torch.equal(found.points[:, :, :, 3], depth) and (found.points[:, :, :, 4:] == 0).all()
    assert torch.equal(found.ids, batch.ids) and torch.equal(found.mask, batch.mask)
    assert batch.texts == ("", "camera 1", "camera 2")
    for view, number in enumerate((0, 1, 2)):
        assert torch.equal(found.text[:, :, view], text[number].expand(2, 2, -1, -1))
    assert not found.single_frames.any()


@pytest.mark.parametrize("part", DROPPABLE)
def test_dropped_parts_have_the_values_of_the_protocol(part: str) -> None:
    """Of the first clip alone, and nothing else changes."""
    found, _, (_, text, *_) = made(part)
    whole, _, _ = made()
    expected = {name: getattr(whole, name).clone() for name in ("text", "layout", "points", "ids", "single_frames")}
    if part == "text":
        expected["text"][0] = text[0]
    elif part in ("boxes", "map"):
        expected["layout"][0, :, :, slice(0, 3) if part == "boxes" else slice(3, 6)] = 0.1255
    elif part == "action":
        expected["ids"][0, :, :, 11:] = -1000.0
    elif part == "depth":
        expected["points"][0, :, :, 3] = -1.0
    elif part == "color":
        expected["points"][0, :, :, :3] = 0.1255
    else:
        expected["single_frames"][0] = True
    for name, values in expected.items():
        assert torch.equal(getattr(found, name), values), name
        is_changed = (getattr(found, name) != getattr(whole, name)).flatten(1).any(1) if values.ndim > 1 else values
        assert not is_changed[1], name
    changed = [name for name, values in expected.items() if not torch.equal(values, getattr(whole, name))]
    assert len(changed) == 1


def test_chances_of_the_dropouts() -> None:
    options = StepOptions()
    assert [options.chance(part) for part in DROPPABLE] == [0.2, 0.2, 0.2, 0.2, 0.1, 0.1, 0.1]


def test_velocity_targets() -> None:
    config = replace(TINY, prediction="velocity", zero_snr=True)
    found, targets, (_, _, latents, given) = made(config=config)
    timesteps, _ = levels_of(given, StepOptions())
    scheduler = diffusers.DDPMScheduler(**TABLE, rescale_betas_zero_snr=True)
    each = timesteps[:, :, None].expand(2, 2, 3).flatten()
    expected = scheduler.get_velocity(latents.flatten(0, 2), given.noise.flatten(0, 2), each)
    assert torch.equal(targets.output.flatten(0, 2), expected)


def test_loss_of_frames_that_count() -> None:
    output = torch.zeros(2, 2, 3, 4, 7, 13)
    target = torch.tensor([[10.0, 2.0], [1.0, 3.0]])[:, :, None, None, None, None].expand(output.shape)
    targets = Targets(target, torch.tensor([[False, True], [True, True]]))
    errors = errors_of(output, targets)
    assert errors.tolist() == [[100.0, 4.0], [1.0, 9.0]]
    assert float(loss_of(errors, targets)) == pytest.approx((4.0 + 1.0 + 9.0) / 3)


def test_camera_and_motion_numbers_equal_those_of_poses() -> None:
    """The numbers of a clip follow from its poses, and from intrinsics in pixels."""
    given = clip(3)
    found = collate([given], TINY).ids[0]
    size = torch.tensor([1600.0, 900.0], dtype=torch.float64)  # width, height
    k = torch.zeros(1, 2, 3, 3, 3, dtype=torch.float64)
    k[..., 0, 0], k[..., 1, 1] = given.cameras[..., 12] * size[0], given.cameras[..., 13] * size[1]
    k[..., 0, 2], k[..., 1, 2] = given.cameras[..., 14] * size[0], given.cameras[..., 15] * size[1]
    pose = torch.eye(4, dtype=torch.float64).repeat(1, 2, 3, 1, 1)
    pose[..., :3, :] = given.cameras[..., :12].view(2, 3, 3, 4)
    forward, left, yaw = given.action[1].double().tolist()
    ego = torch.eye(4, dtype=torch.float64).repeat(1, 2, 1, 1, 1)
    ego[0, 1, 0, :2, :2] = torch.tensor([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    ego[0, 1, 0, :2, 3] = torch.tensor([forward, left])
    expected = added_time_ids(k, size.expand(1, 2, 3, 2), pose, ego, 2.0)[0]
    assert (found - expected).abs().max() < 1e-5 and (found[..., 0] == 2.0).all()
    assert float(found[1, 0, 11]) == pytest.approx(math.hypot(forward, left) * 2.0 * 3.6, rel=1e-6)


def test_neighbors_in_any_order() -> None:
    order = [3, 0, 5, 1, 4, 2]
    names = tuple(CAMERAS[i] for i in order)
    mask = visible(Rig(names, ((8, 8),) * 6, 2.0))
    around = {(names[i], names[j]) for i, j in mask.nonzero().tolist()}
    assert around == {(CAMERAS[i], CAMERAS[(i + step) % 6]) for i in range(6) for step in (-1, 0, 1)}
    assert visible(Rig(("a", "b", "c", "d"), ((8, 8),) * 4, 2.0))[0].tolist() == [True, True, False, True]


def test_sines_and_cosines_fill_the_points() -> None:
    """In the training from bins, and at inference from depths: docs/src/reference/maps.md."""
    config = replace(TINY, depth="both", depth_bins=16)
    given = clip(bins=torch.arange(17).repeat(2, 3, 56, 7)[..., :104].to(torch.int16), recipe={"bins": {"count": 16}})
    batch = collate([given], config)
    uniforms = {name: torch.ones(1) for name in DROPPABLE}
    sampled = draws(clips=1, **uniforms)
    text = torch.zeros(3, 77, 24)
    inputs, _ = noisy_inputs(batch, text, sampled.noise, sampled, Schedule(), config)
    waves = inputs.points[0, 0, 0, 3:, 0]
    for column, number in enumerate(batch.bins[0, 0, 0, 0].tolist()):
        u = min(number, 15) / 15
        frequencies = [2.0 ** (k * math.log2(16 / 2) / 7) for k in range(8)]
        phases = [2 * math.pi * u * frequency for frequency in frequencies]
        expected = [u, *map(math.sin, phases), *map(math.cos, phases)] if number else [-1.0] + [0.0] * 16
        assert waves[:, column].tolist() == pytest.approx(expected, abs=1e-5)
    four = inputs.points[:, :, :, :4]
    assert torch.equal(point_channels(four, config), inputs.points)
    assert (point_channels(four, TINY)[:, :, :, 4:] == 0).all()
    assert torch.equal(point_channels(four, TINY)[:, :, :, :4], four)


@pytest.mark.parametrize(
    ("clips", "config", "message"),
    [
        ([{"frames": 1}], TINY, "expected clips of at least 2 frames, found 1: log log-a, frame 0"),
        (
            [{"size": (56, 100)}],
            TINY,
            "expected height and width in multiples of 8, found 56x100: log log-a, frame 0",
        ),
        (
            [{}, {"views": 2, "log": "log-b"}],
            TINY,
            "expected images of [2, 3, 3, 56, 104] as in the first clip of the batch, found [2, 2, 3, 56, 104]: "
            "log log-b, frame 0",
        ),
        (
            [{}, {"recipe": {"bins": {"count": 64}}}],
            TINY,
            "expected 256 depth bins as in the first clip of the batch, found 64: log log-a, frame 0",
        ),
        (
            [{"recipe": RECIPE}],
            replace(TINY, depth="both", depth_bins=64),
            "expected 64 depth bins, found 256: log log-a, frame 0",
        ),
        (
            [{"recipe": {"bins": {"count": "many"}}}],
            TINY,
            "expected bins.count as a whole number in the recipe of log log-a, frame 0, found 'many'",
        ),
    ],
)
def test_other_clips_are_rejected(clips: list[dict[str, Any]], config: Config, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        collate([clip(**changed) for changed in clips], config)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"drop_text": 1.5}, "expected drop_text of 0 to 1, found 1.5"),
        ({"previous_share": -0.1}, "expected previous_share of 0 to 1, found -0.1"),
        (
            {"previous_from": 300},
            "expected previous_from of at most previous_to, from 0 to 999, found 300 and 200",
        ),
        (
            {"previous_to": 1000},
            "expected previous_from of at most previous_to, from 0 to 999, found 50 and 1000",
        ),
    ],
)
def test_other_options_are_rejected(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        StepOptions(**changed)
