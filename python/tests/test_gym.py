"""Environments for Gymnasium."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DRIVE

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.utils.env_checker import check_env  # noqa: E402



@pytest.fixture(scope="module")
def options(drive: Path) -> dict[str, Any]:
    return {"log": DRIVE, "skeleton": str(drive / "skeleton"), "size": (28, 50), "steps": 6}


@pytest.mark.parametrize("action", ["waypoints", "controls"])
def test_environments_pass_the_checker(options: dict[str, Any], action: str) -> None:
    env = gymnasium.make("pskel.gym:pskel/Drive-v0", action=action, render_mode="rgb_array", **options)
    check_env(env.unwrapped)
    env.close()


def test_vector_environments_step_together(options: dict[str, Any]) -> None:
    mode = "vector_entry_point"
    envs = gymnasium.make_vec("pskel.gym:pskel/Drive-v0", num_envs=2, vectorization_mode=mode, **options)
    seen, _ = envs.reset(seed=3)
    assert seen["images"].shape == (2, 6, 28, 50, 3)
    for _ in range(8):
        seen, reward, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert reward.shape == (2,) and envs.observation_space.contains(seen)
    envs.close()


def test_environments_step_in_processes_of_their_own(options: dict[str, Any]) -> None:
    envs = gymnasium.make_vec(
        "pskel.gym:pskel/Drive-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "forkserver"},
        **options,
    )
    seen, _ = envs.reset(seed=3)
    assert seen["images"].shape == (2, 6, 28, 50, 3)
    envs.close()


def test_a_seed_reproduces_an_episode(options: dict[str, Any]) -> None:
    def episode() -> list[Any]:
        env = gymnasium.make("pskel.gym:pskel/Drive-v0", **options)
        seen, _ = env.reset(seed=11)
        made = [seen]
        env.action_space.seed(11)
        for _ in range(4):
            seen, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            made.append((seen, reward, terminated, truncated))
            if terminated or truncated:
                break
        return made

    np.testing.assert_equal(episode(), episode())


@pytest.mark.parametrize("action", ["waypoints", "controls"])
def test_driving_along_the_route_is_rewarded(options: dict[str, Any], action: str) -> None:
    env = gymnasium.make("pskel.gym:pskel/Drive-v0", action=action, actors="replay", **options)
    seen, info = env.reset(options={"frame": 0})
    total, steps, truncated, terminated = 0.0, 0, False, False
    while not (truncated or terminated):
        if action == "controls":
            chosen = np.array([0.5, 0.0], np.float32)
        else:
            chosen = np.zeros((8, 3), np.float32)
            chosen[:, :2] = seen["route"][1:9] * 0.5
        seen, reward, terminated, truncated, info = env.step(chosen)
        total, steps = total + float(reward), steps + 1
    assert truncated and not terminated and steps == 6 and total > 0.3
    assert info["metrics"]["collisions"] == []
    with pytest.raises(RuntimeError, match="expected a reset"):
        env.unwrapped.step(chosen)
    env.reset()
    with pytest.raises(ValueError, match=rf"expected an action \[{', '.join(map(str, chosen.shape))}\], found \[5\]"):
        env.unwrapped.step(np.zeros(5, np.float32))


def test_bad_options_are_rejected(options: dict[str, Any]) -> None:
    for wrong, message in [
        ({"action": "steer"}, "waypoints or controls"),
        ({"actors": "fly"}, "actors to be one of"),
        ({"render_mode": "ansi"}, "rgb_array"),
    ]:
        with pytest.raises(ValueError, match=message):
            env = gymnasium.make("pskel.gym:pskel/Drive-v0", **{**options, **wrong}).unwrapped
            env.reset()
