"""The denoising loop with a Python function as the network."""

from typing import Any

import numpy as np
import pskel
import pytest

SHAPE = (2, 3, 4, 5)
Array = np.ndarray[Any, np.dtype[np.float32]]


@pytest.fixture(scope="module")
def drive() -> pskel.Log:
    return pskel.Log("town:seed=7,frames=20,size=113x200")


def network(latents: Array, timesteps: Array, sigmas: Array, conditions: list[float]) -> Array:
    """A velocity that depends on all frames of the window and on their conditions."""
    level = np.array(conditions, np.float32)[:, None, None, None, None]
    return latents - level + 0.1 * latents.mean(axis=0, keepdims=True) + 0.01 * sigmas[:, None, None, None, None]


def run(
    drive: pskel.Log, frames: int, *, disturb: bool = False, save_at: int | None = None, **options: Any
) -> tuple[list[Array], pskel.ResetAndRoll]:
    """Generates frames along the log. `disturb`: forecasts are wrong in all but the last frame. `save_at`: continues in
    a new loop from this frame."""

    def create() -> pskel.ResetAndRoll:
        return pskel.ResetAndRoll(network, SHAPE, window=4, steps=8, seed=3, **options)

    loop = create()
    simulation = pskel.Simulation(drive, ego="replay", steps=36)
    conditions: list[pskel.Committed[float]] = []
    made: list[Array] = []
    for number, _ in enumerate(simulation):
        now = simulation.committed.map(lambda scene: float(scene.ego[0, 3]) % 1.0)
        conditions.append(now)
        if number < loop.references:
            loop.add_reference(np.full(SHAPE, number, np.float32), now)
            continue
        if len(made) == frames:
            break
        wrong = disturb and len(made) < frames - 1
        forecasts = [
            forecast.map(lambda scene: 9.0 if wrong else float(scene.ego[0, 3]) % 1.0)
            for forecast in simulation.forecast(loop.forecasts)
        ]
        if len(made) == save_at:
            saved = loop.save()
            loop = create()
            loop.load(saved, conditions[-1 - loop.references : -1])
        made.append(loop.step(now, forecasts))
    assert len(made) == frames
    return made, loop


@pytest.mark.parametrize("strategy", ["reset_and_roll", "rolling", "causal", "non_causal"])
def test_frames_are_reproducible_and_resume(drive: pskel.Log, strategy: str) -> None:
    whole, _ = run(drive, 5, strategy=strategy)
    assert all(frame.shape == SHAPE and frame.dtype == np.float32 for frame in whole)
    again, _ = run(drive, 5, strategy=strategy)
    resumed, _ = run(drive, 5, strategy=strategy, save_at=2)
    for first, second, third in zip(whole, again, resumed, strict=True):
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(first, third)


def test_other_seeds_and_samplers_give_other_frames(drive: pskel.Log) -> None:
    flow, _ = run(drive, 1)
    ddim, _ = run(drive, 1, sampler="ddim", prediction="sample")
    assert (flow[0] != ddim[0]).any()


def test_the_cache_does_not_depend_on_forecasts(drive: pskel.Log) -> None:
    """After a reset, nothing of a forecast remains: frames share only committed history."""
    true, kept = run(drive, 1)
    false, disturbed = run(drive, 1, disturb=True)
    np.testing.assert_array_equal(true[0], false[0])  # the last frame is undisturbed
    assert kept.save() == disturbed.save()


def test_types_and_shapes_are_checked(drive: pskel.Log) -> None:
    simulation = pskel.Simulation(drive, ego="replay", steps=20)
    committed = simulation.committed.map(lambda scene: 0.0)
    loop = pskel.ResetAndRoll(network, SHAPE, window=2, steps=2)
    with pytest.raises(TypeError, match="Forecast|Committed"):
        loop.add_reference(np.zeros(SHAPE), simulation.forecast(1)[0])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="expected a latent of 2x3x4x5"):
        loop.add_reference(np.zeros((2, 3, 4)), committed)
    with pytest.raises(ValueError, match="finite values"):
        loop.add_reference(np.full(SHAPE, np.inf), committed)
    with pytest.raises(ValueError, match="expected 1 references before the first step, found 0"):
        loop.step(committed, [])
    loop.add_reference(np.zeros(SHAPE), committed)
    with pytest.raises(ValueError, match="expected 1 references, found one more"):
        loop.add_reference(np.zeros(SHAPE), committed)
    with pytest.raises(TypeError):
        loop.step(committed, [committed])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="found none"):
        loop.save()
    with pytest.raises(ValueError):
        loop.load(b"damaged", [])
    for options, message in [
        ({"window": 1}, "a window of 2 to 64"),
        ({"steps": 7, "window": 4}, "a multiple of 4"),
        ({"strategy": "jump"}, "expected the strategy"),
        ({"sampler": "euler"}, "expected the sampler"),
        ({"sampler": "ddim", "prediction": "x"}, "expected the prediction"),
        ({"shift": 0.0}, "a shift above 0"),
        ({"prediction": "sample"}, "expected no prediction with the sampler flow_match, found sample"),
    ]:
        with pytest.raises(ValueError, match=message):
            pskel.ResetAndRoll(network, SHAPE, **options)  # type: ignore[arg-type]


def test_errors_of_the_network_pass_through(drive: pskel.Log) -> None:
    committed = pskel.Simulation(drive, ego="replay", steps=2).committed.map(lambda scene: 0.0)

    class Mine(Exception):
        pass

    def fails(*_: Any) -> Array:
        raise Mine("out of memory")

    for function, expected, message in [
        (fails, Mine, "out of memory"),
        (lambda latents, *_: latents[:1, :1], ValueError, r"expected a prediction of \[2, 2, 3, 4, 5\]"),
        (lambda latents, *_: latents * np.nan, pskel.Error, "finite values"),
        (lambda *_: "image", TypeError, "real numbers"),
    ]:
        loop = pskel.ResetAndRoll(function, SHAPE, window=2, steps=2)  # type: ignore[arg-type]
        loop.add_reference(np.zeros(SHAPE), committed)
        with pytest.raises(expected, match=message):  # type: ignore[call-overload]
            loop.step(committed, [])


def test_guidance_drops_conditions(drive: pskel.Log) -> None:
    dropped: list[tuple[str, ...]] = []

    class Condition:
        def without(self, *parts: str) -> "Condition":
            dropped.append(parts)
            return Condition()

    committed = pskel.Simulation(drive, ego="replay", steps=2).committed.map(lambda scene: Condition())
    loop = pskel.ResetAndRoll(lambda latents, *_: latents, SHAPE, window=2, steps=2, guidance=2.0)
    loop.add_reference(np.zeros(SHAPE), committed)
    loop.step(committed, [])
    assert set(dropped) == {("layout", "action")}
