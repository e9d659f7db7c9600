"""Noise levels of training clips: independent, as in a roll, and of clean reference frames."""

from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
import numpy as np  # noqa: E402
from pas_rolls import roll_out  # noqa: E402
from pskel.models.pas import FrameCondition  # noqa: E402
from pskel.models.pas.training.draws import Draws  # noqa: E402
from pskel.models.pas.training.step import StepOptions, levels_of, noisy_inputs, sigmas_of  # noqa: E402
from test_pas_train_task import batch_of_clip  # noqa: E402

LAST = 0.003 / 1.002
"""Of the table: sigma = 3 s / (1 + 2 s), s = 0.001."""


def draws_of(clips: int, frames: int, **values: Any) -> Draws:
    drawn = Draws.sample(torch.Generator().manual_seed(3), clips, (frames, 1, 1, 2, 2))
    return drawn._replace(**{name: torch.as_tensor(value) for name, value in values.items()})


def times_of(sigma: Any) -> Any:
    """Undo the shift: s = sigma / (3 - 2 sigma)."""
    return sigma / (3.0 - 2.0 * sigma)


def test_levels_are_independent_by_default() -> None:
    """The authors' step: also where the new numbers are smallest."""
    draws = draws_of(5, 4, roll=[0.0] * 5, references=[0.0] * 5)
    assert torch.equal(levels_of(draws, StepOptions()), sigmas_of(draws.level))


def test_levels_of_a_roll_rise_by_hand() -> None:
    """Four frames at the times (j + u) / 4; a clip whose number is above the share has independent levels."""
    draws = draws_of(3, 4, roll=[0.0, 0.69, 0.71], roll_place=[0.5, 0.0, 0.5])
    found = levels_of(draws, StepOptions(roll_levels=0.7))
    assert times_of(found[0]).tolist() == pytest.approx([0.125, 0.375, 0.625, 0.875], abs=1e-6)
    assert times_of(found[1]).tolist() == pytest.approx([0.001, 0.25, 0.5, 0.75], abs=1e-6)
    assert torch.equal(found[2], sigmas_of(draws.level)[2])


@pytest.mark.parametrize("steps", [6, 36])
def test_levels_of_a_roll_are_those_of_the_loop(steps: int) -> None:
    """All windows of Reset-and-Roll after its references have left it, with the table of diffusers' scheduler."""
    window = 3
    seen: list[Any] = []

    def still(latents: Any, timesteps: Any, sigmas: Any, _: Any) -> Any:
        seen.append(torch.from_numpy(np.copy(sigmas)))
        return np.zeros_like(latents)

    frame, driven = np.zeros((1, 1, 1, 1), np.float32), 3
    maps = np.zeros((1, 4, 8, 8)), np.zeros((1, 6, 8, 8))
    conditions = [FrameCondition.create(*maps, [0.0] * 3, np.zeros((1, 16)))] * 9
    roll_out(still, [frame] * (window - 1), conditions, [[frame] * window] * driven, 1.0, steps)
    calls = seen[-steps:]  # of the last frame, whose window has no reference
    share = steps // window
    for number, sigmas in enumerate(calls):
        place = (share - 1 - number % share) / share
        draws = draws_of(1, window, roll=[0.0], roll_place=[place])
        found = times_of(levels_of(draws, StepOptions(roll_levels=1.0))[0])
        # The scheduler's times end at 0.003 and not at 0, after steps of 1 / (steps - 1).
        assert float((found - times_of(sigmas)).abs().max()) < 1.0 / steps + 0.004
    assert len(seen) == driven * steps and float(times_of(calls[0])[-1]) == 1.0


def test_reference_frames_are_clean() -> None:
    """The first 1 to T - 1 frames are at the last level, the others as without references."""
    counts = [0.0, 0.34, 0.67, 0.999]
    draws = draws_of(5, 4, references=[0.0] * 4 + [0.5], reference_count=[*counts, 0.0], roll=[0.0, 1.0] * 2 + [1.0])
    found = levels_of(draws, StepOptions(clean_references=0.5, roll_levels=0.5))
    without = levels_of(draws, StepOptions(roll_levels=0.5))
    for clip, known in enumerate([1, 2, 3, 3, 0]):
        assert found[clip, :known].tolist() == pytest.approx([LAST] * known, rel=1e-6)
        assert torch.equal(found[clip, known:], without[clip, known:])
    assert float(without.min()) > LAST


def test_shares_are_those_of_the_options() -> None:
    """Of 4000 clips of 5 frames, within 4 standard deviations: 0.3 of rolls, 0.6 with 1 to 4 references, evenly."""
    draws = draws_of(4000, 5)
    rolled = levels_of(draws, StepOptions(roll_levels=0.3))
    rises = (rolled.diff(dim=1) > 0).all(dim=1) & (times_of(rolled).diff(dim=1) - 0.2).abs().lt(0.0011).all(dim=1)
    assert abs(float(rises.float().mean()) - 0.3) < 4 * (0.21 / 4000) ** 0.5
    known = (levels_of(draws, StepOptions(clean_references=0.6)) < 1.01 * LAST).sum(dim=1)
    shares = [float((known == count).float().mean()) for count in range(6)]
    for found, expected in zip(shares, [0.4, *[0.15] * 4, 0.0]):
        assert abs(found - expected) < 4 * (max(expected, 1e-9) * (1 - expected) / 4000) ** 0.5 + 1e-3


def test_inputs_have_these_levels() -> None:
    """A reference is nearly its latent, with timestep 3; the other frame of the clip has its level of the roll."""
    from pskel.models.pas.training.step import Texts

    batch = batch_of_clip()
    latents = torch.randn(1, 2, 3, 16, 4, 8, generator=torch.Generator().manual_seed(1))
    drawn = Draws.sample(torch.Generator().manual_seed(2), 1, latents.shape[1:])
    drawn = drawn._replace(roll=torch.zeros(1), roll_place=torch.full((1,), 0.5), references=torch.zeros(1))
    options = StepOptions(roll_levels=1.0, clean_references=1.0, input_scale_std=0.0, input_offset_std=0.0)
    inputs, targets = noisy_inputs(batch, Texts(torch.zeros(3, 1, 1), torch.zeros(3, 1)), latents, drawn, options)
    level = 3 * 0.75 / (1 + 2 * 0.75)
    assert targets.sigma[0].tolist() == pytest.approx([LAST, level])
    assert inputs.timestep[0, :, 0].tolist() == pytest.approx([1000 * LAST, 1000 * level])
    expected = level * drawn.noise[:, 1] + (1 - level) * latents[:, 1]
    torch.testing.assert_close(inputs.sample[:, 1], expected)
    assert float((inputs.sample[:, 0] - latents[:, 0]).abs().max()) < 0.003 * 8
