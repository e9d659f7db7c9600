"""Rollouts with the video network: by the rules of the loop, through its process, and by the loop of the package."""

import json

import numpy as np
import pskel
import pytest
from pas_base import Array, Peer, unpack

pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
from pas_frames import SHAPE, H, L, V, W, condition, needs_fixture, request, window  # noqa: E402
from pas_rolls import Network, roll_out  # noqa: E402
from pskel.models.pas import Denoiser, FrameCondition  # noqa: E402

pytest_plugins = ["pas_frames"]
pytestmark = needs_fixture

STEPS = 3


def run_loop(network: Network, references: list[Array], count: int, guidance: float) -> list[Array]:
    """The same by ``pskel.ResetAndRoll``, along a log whose states carry the number of their frame."""
    simulation = pskel.Simulation(pskel.Log("town:seed=7,frames=20,size=113x200"), ego="replay", steps=36)
    loop = pskel.ResetAndRoll(network, SHAPE, window=L, steps=STEPS, guidance=guidance, seed=3)
    frames: list[Array] = []
    for number, _ in enumerate(simulation):
        now = simulation.committed.map(lambda _: condition(number))
        if number < loop.references:
            loop.add_reference(references[number], now)
            continue
        forecasts = simulation.forecast(loop.forecasts)
        ahead = [forecast.map(lambda _: condition(number + 1 + i)) for i, forecast in enumerate(forecasts)]
        frames.append(loop.step(now, ahead))
        if len(frames) == count:
            break
    return frames


def through(peer: Peer) -> Network:
    """The denoiser process as a function."""

    def network(latents: Array, timesteps: Array, sigmas: Array, conditions: list[FrameCondition]) -> Array:
        waves = np.full((V, 16, H, W), 0.5, np.float32)  # the network does not use them
        frames = [
            {
                "points": np.concatenate([frame.points.array, waves], axis=1),
                "layout": frame.layout.array,
                "action": frame.action,
                "cameras": frame.cameras,
                "prompt": frame.prompt,
            }
            for frame in conditions
        ]
        return unpack(peer.ask(*request(latents, timesteps, sigmas, frames)))[1]["prediction"]

    return network


def test_one_call_gives_both_halves_of_guidance(peer: Peer, denoiser: Denoiser) -> None:
    """The answer to a call with dropped parts is that to two calls."""
    latents, timesteps, sigmas, frames = window()
    conditions = [FrameCondition.create(**frame) for frame in frames]
    for names in (["layout", "action"], ["layout", "action", "color", "depth"]):
        texts, tensors = request(latents, timesteps, sigmas, frames)
        both = unpack(peer.ask({**texts, "dropped": json.dumps(names)}, tensors))[1]
        assert sorted(both) == ["prediction", "unconditional"]
        bare = [condition.without(*names) for condition in conditions]
        np.testing.assert_array_equal(both["prediction"], denoiser(latents, timesteps, sigmas, conditions))
        np.testing.assert_array_equal(both["unconditional"], denoiser(latents, timesteps, sigmas, bare))
        assert (both["prediction"] != both["unconditional"]).any()
    with pytest.raises(ValueError, match="expected parts of layout, action, color, depth, found text"):
        denoiser.predict_guided(latents, timesteps, conditions, ["text"])


@pytest.mark.parametrize("guidance", [1.0, 2.0])
def test_rollouts_are_the_same(peer: Peer, denoiser: Denoiser, guidance: float) -> None:
    """By the rules of the loop in this file, through the process and in this one, and by the loop of the package."""
    count = 3
    images = np.random.default_rng(9).random((L - 1, V, 3, H, W), np.float32)
    references = [denoiser.encode(image) for image in images]
    # A network without velocity shows the noise of the loop: one call per roll, the new frame last.
    seen: list[tuple[Array, Array, Array]] = []

    def still(latents: Array, timesteps: Array, sigmas: Array, _: list[FrameCondition]) -> Array:
        seen.append((latents[-1].copy(), timesteps, sigmas))
        return np.zeros_like(latents)

    run_loop(still, references, count, 1.0)
    assert len(seen) == count * L
    noise = [[draw for draw, _, _ in seen[step * L : (step + 1) * L]] for step in range(count)]

    conditions = [condition(i) for i in range(count + 2 * L)]
    rolled = roll_out(denoiser, references, conditions, noise, guidance, STEPS)
    other = roll_out(through(peer), references, conditions, noise, guidance, STEPS)
    looped = run_loop(denoiser, references, count, guidance)
    assert len(rolled) == len(other) == len(looped) == count
    for ours, theirs, packaged in zip(rolled, other, looped):
        assert np.isfinite(ours).all()
        np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(ours, packaged)
    assert (rolled[0] != rolled[1]).any()
