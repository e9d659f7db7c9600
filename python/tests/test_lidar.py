"""LiDAR sweeps of scenes and simulations."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from conftest import DRIVE, TOWN, Run

DEVICE = {"name": "top", "elevations_deg": [-20.0, -10.0, -5.0, -2.0, 0.0, 5.0], "columns": 90, "range_m": [1.0, 80.0], "sweep_s": 0.1}


@pytest.fixture
def small(tmp_path: Path) -> str:
    """The description of a small device."""
    path = tmp_path / "top.json"
    path.write_text(json.dumps({"devices": [DEVICE]}))
    return str(path)


def test_descriptions_are_those_of_the_files(small: str) -> None:
    spec = pskel.lidar_spec(small)
    device = spec["devices"][0]
    assert {name: device[name] for name in DEVICE} == DEVICE and device["ego_from_lidar"] is None
    assert [len(device["elevations_deg"]) for device in pskel.lidar_spec("av2")["devices"]] == [32, 32]
    with pytest.raises(ValueError, match="at128.*found \"hdl\""):
        pskel.lidar_spec("hdl")


def test_sweeps_equal_those_of_the_command(
    run: Run, log: pskel.Log, skeleton: pskel.Skeleton, renderer: pskel.Renderer, small: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    lidar = [f"--lidar={small}", "--lidar-format=npy", "--maps=depth", "--size=56x100"]
    run("-m", "pskel", "render", TOWN, f"--skeleton={skeleton.path}", f"--out={out}", "--frames=2..3", *lidar)
    expected = np.load(next(out.glob("*/lidar.npy")))
    scene = log[2]
    found = renderer.lidar(scene, small, other=log.at(scene.t_us - 100_000), position=log.lidar_position)
    assert len(expected) > 200
    columns = [found[name] for name in ("intensity", "ring", "device", "class", "instance", "time")]
    np.testing.assert_array_equal(np.column_stack([found["points"], *columns]), expected)
    assert [ranges.shape for ranges in found["range"]] == [(6, 90)]
    with pytest.raises(ValueError, match="expected a position of top on the ego"):
        renderer.lidar(scene, small)


def test_simulations_know_the_step_before(drive: Path, renderer: pskel.Renderer, small: str) -> None:
    log = pskel.Log(DRIVE)
    simulation = pskel.Simulation(log, ego="replay", steps=4)
    assert simulation.previous is None
    seen = []
    while True:
        seen.append(simulation.scene)
        if not simulation.step():
            break
        before = simulation.previous
        assert before is not None and before.t_us == seen[-1].t_us
        np.testing.assert_array_equal(before.ego, seen[-1].ego)
    assert len(seen) == 5
    before = simulation.previous
    assert before is not None and before.t_us == seen[-2].t_us


def test_environments_have_sweeps(drive: Path, small: str) -> None:
    gymnasium = pytest.importorskip("gymnasium")
    options: dict[str, Any] = {"log": DRIVE, "skeleton": str(drive / "skeleton"), "size": (28, 50), "steps": 3, "lidar": small}
    env = gymnasium.make("pskel.gym:pskel/Drive-v0", **options)
    seen, _ = env.reset(seed=1, options={"frame": 1})
    for _ in range(3):
        assert env.observation_space.contains(seen) and seen["lidar"].shape == (540, 6)
        returns = seen["lidar"][:, 5] == 1.0
        count = int(returns.sum())
        assert count > 100 and returns[:count].all() and not seen["lidar"][count:].any()
        ranges = np.linalg.norm(seen["lidar"][:count, :3], axis=1)
        assert ranges.max() < 85.0 and set(seen["lidar"][:count, 4]) <= {0.0, 1.0, 2.0, 3.0, 4.0, 5.0}
        seen, _, terminated, truncated, _ = env.step(np.zeros((8, 3), np.float32))  # stops
        if terminated or truncated:
            break
    env.close()
