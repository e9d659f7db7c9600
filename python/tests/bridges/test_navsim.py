"""Agents of NAVSIM in rollouts, and rollouts as scenes of NAVSIM.

Scenes need nuplan-devkit, whose Python is named by PSKEL_DEVKIT_PYTHON. If PSKEL_NAVSIM names a NAVSIM
checkout, NAVSIM's own classes also read them.
"""

import json
import os
import pickle
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DRIVE

image = pytest.importorskip("PIL.Image")

TESTS = Path(__file__).parent
SHARED = Path(os.environ.get("PSKEL_SHARED", TESTS.parents[3] / "shared"))
DEVKIT = SHARED / "interop/nuplan-devkit"
PYTHON = os.environ.get("PSKEL_DEVKIT_PYTHON")
devkit = pytest.mark.skipif(PYTHON is None or not DEVKIT.exists(), reason="needs PSKEL_DEVKIT_PYTHON and nuplan-devkit")


def agent(seen: Path, *options: str) -> str:
    arguments = json.dumps({"seen": str(seen)})
    command = [sys.executable, "-m", "pskel.navsim_agent", "navsim_agents:Straight", "--args", arguments, *options]
    return f"PYTHONPATH={TESTS} {shlex.join(command)}"


def simulate(drive: Path, out: Path, planner: str, *options: str, steps: int = 60, code: int = 0, fails: str = "", warmup: int = 4) -> str:
    command = [sys.executable, "-m", "pskel", "simulate", DRIVE, f"--skeleton={drive / 'skeleton'}", f"--out={out}", f"--steps={steps}"]
    command += ["--sim-hz=10", "--plan-hz=2", f"--warmup={warmup}", "--size=56x100", "--maps=color", "--ego=external", f"--planner={planner}"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=180, check=False, env={**os.environ, "FAILS": fails})
    assert done.returncode == code, done.stderr
    return done.stderr


def states(out: Path) -> list[Any]:
    return [json.loads(line) for line in (out / "states.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def driven(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A rollout of 6 s, and what the agent saw."""
    folder = tmp_path_factory.mktemp("navsim")
    simulate(drive, folder / "out", agent(folder / "seen"), "--lidar=hdl-32e")
    return folder / "out", folder / "seen"


def test_an_agent_sees_four_frames_at_2_hz_and_drives(driven: tuple[Path, Path]) -> None:
    out, seen = driven
    rows = states(out)
    calls = sorted(seen.glob("*.npz"))
    assert len(rows) == 61 and len(calls) == 9  # plans at steps 15, 20 .. 55
    assert json.loads((seen / "types.json").read_text()) == ["pskel._navsim_types", 4]
    for call, path in enumerate(calls):
        see = np.load(path)
        now = 15 + 5 * call
        frames = [rows[now - 5 * back] for back in (3, 2, 1, 0)]
        origin = np.array(rows[now]["ego"]["global_from_ego"])
        for index, row in enumerate(frames):
            ego, step = row["ego"], out / f"steps/{row['step']:06}"
            local = np.linalg.inv(origin) @ np.array(ego["global_from_ego"])
            expected = [*local[:2, 3], np.arctan2(local[1, 0], local[0, 0])]
            np.testing.assert_allclose(see["ego_pose"][index], expected, atol=2e-3)  # the town's ground is level
            np.testing.assert_allclose(see["ego_velocity"][index], [ego["speed_mps"], 0.0], rtol=1e-6)
            across = ego["speed_mps"] * ego["yaw_rate_radps"]
            np.testing.assert_allclose(see["ego_acceleration"][index], [ego["acceleration_mps2"], across], rtol=1e-6, atol=1e-9)
            names = ["left", "straight", "right", "unknown"]
            assert see["driving_command"][index].tolist() == [int(row["driving_command"] == name) for name in names]
            for name, channel in (("cam_f0", "CAM_FRONT"), ("cam_b0", "CAM_BACK")):
                if name == "cam_b0" and index < 3:
                    assert f"{name}.{index}" not in see
                    continue
                with image.open(step / channel / "color.png") as file:
                    np.testing.assert_array_equal(see[f"{name}.{index}"], np.asarray(file.convert("RGB")))
                camera = next(c for c in json.loads((step / "meta.json").read_text())["cameras"] if c["name"] == channel)
                mount = np.array(camera["ego_from_camera"])
                np.testing.assert_allclose(see[f"{name}.{index}.rotation"], mount[:3, :3])
                np.testing.assert_allclose(see[f"{name}.{index}.translation"], mount[:3, 3])
                np.testing.assert_allclose(see[f"{name}.{index}.intrinsics"], camera["intrinsics"])
        assert not [key for key in see if key.startswith(("cam_l", "lidar.0", "lidar.1", "lidar.2"))]
        points = np.fromfile(out / f"steps/{now:06}/lidar.pcd.bin", "<f4").reshape(-1, 5)
        assert len(points) > 1000
        np.testing.assert_array_equal(see["lidar.3"], np.column_stack([points, np.zeros(len(points))]).T)
    # 4 m/s straight on from the last warm-up step: 1.5 s to 6 s.
    local = np.linalg.inv(np.array(rows[15]["ego"]["global_from_ego"])) @ np.array(rows[60]["ego"]["global_from_ego"])
    np.testing.assert_allclose(local[:2, 3], [18.0, 0.0], atol=1e-4)
    assert rows[60]["ego"]["speed_mps"] == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("fails", "expected"),
    [
        ("nan", 'found the error "expected a trajectory of finite poses [N, 3], found float64 [8, 3]"'),
        ("shape", 'found the error "expected a trajectory of finite poses [N, 3], found float64 [8, 2]"'),
    ],
)
def test_failures_of_agents_keep_what_was_committed(drive: Path, tmp_path: Path, fails: str, expected: str) -> None:
    errors = simulate(drive, tmp_path / "out", agent(tmp_path / "seen"), steps=30, code=1, fails=fails)
    assert expected in errors and "stopped after 21 steps" in errors, errors
    before = states(tmp_path / "out")
    simulate(drive, tmp_path / "out", agent(tmp_path / "seen"), "--resume", steps=30)
    simulate(drive, tmp_path / "whole", agent(tmp_path / "seen"), steps=30)
    assert states(tmp_path / "out")[: len(before)] == before
    assert (tmp_path / "out/states.jsonl").read_bytes() == (tmp_path / "whole/states.jsonl").read_bytes()


def test_what_an_agent_needs_is_told(drive: Path, tmp_path: Path) -> None:
    errors = simulate(drive, tmp_path / "a", agent(tmp_path / "seen"), steps=5, code=1, warmup=1)
    assert "expected a state 1.5 s before step 0, found none; start later in the log" in errors
    errors = simulate(drive, tmp_path / "b", agent(tmp_path / "seen"), "--start=1600000001600000", steps=5, code=1, warmup=1)
    assert "expected an image of cam_f0 at step -15, found none; use --warmup 4 --plan-hz 2" in errors
    errors = simulate(drive, tmp_path / "c", agent(tmp_path / "seen", "--images", "boxes"), steps=20, code=1)
    assert "expected an image in " in errors and "CAM_FRONT/boxes.png" in errors


def scenes(out: Path, scenes: Path, *options: str, code: int = 0) -> str:
    """Run pskel.navsim_scenes in the environment of the devkit; returns its output."""
    path = os.pathsep.join(str(folder) for folder in (TESTS.parents[1], DEVKIT))
    command = [str(PYTHON), "-m", "pskel.navsim_scenes", str(out), f"--out={scenes}", *options]
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False, env=environment)
    assert done.returncode == code, done.stderr
    return done.stdout if code == 0 else done.stderr


@devkit
def test_a_rollout_becomes_scenes(driven: tuple[Path, Path], tmp_path: Path) -> None:
    out, _ = driven
    rows = states(out)
    options = ("--map=us-ma-boston", "--steps=15,20", "--future=8", "--original-scene=abc", "--original-token=def")
    paths = [Path(line) for line in scenes(out, tmp_path / "a", *options).splitlines()]
    assert len(paths) == 2 and all(path.parent == tmp_path / "a/synthetic_scene_pickles" for path in paths)
    assert len(list((tmp_path / "a/sensor_blobs").rglob("*.png"))) == 5 * 6, "five frames, three of which are in both scenes"
    reader = [str(PYTHON), str(TESTS / "navsim_reader.py"), str(paths[1]), str(tmp_path / "a/sensor_blobs")]
    path = os.pathsep.join([*os.environ.get("PSKEL_NAVSIM", "").split(os.pathsep), str(DEVKIT)])
    done = subprocess.run(reader, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": path})
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert len(found["future"]) == 8
    points = np.fromfile(out / "steps/000020/lidar.pcd.bin", "<f4").reshape(-1, 5)
    assert found["points"]["shape"] == [6, len(points)]
    np.testing.assert_allclose(found["points"]["sum"], [*points.sum(axis=0, dtype=float), 0.0], rtol=1e-5, atol=0.1)
    for tracks, row in zip(found["future"], rows[25:61:5], strict=True):
        tracks_equal(tracks, row)
    if "navsim" in found:
        scene = found["navsim"]
        assert scene["token"] == paths[1].stem and scene["route"] == []
        tracks_equal(scene["now"], rows[20], 1e-4)
        for tracks, row in zip(scene["later"], rows[25:61:5], strict=True):
            tracks_equal(tracks, row)
        pose = rows[20]["ego"]["global_from_ego"]
        np.testing.assert_allclose(scene["ego"][1:4], [pose[0][3], pose[1][3], rows[20]["ego"]["heading_rad"]], atol=1e-9)
        np.testing.assert_allclose(scene["poses"][3], [0.0, 0.0, 0.0], atol=1e-9)
        assert scene["images"] == [[56, 100, 3]] * 4
        for total, step in zip(scene["front"], (5, 10, 15, 20), strict=True):
            with image.open(out / f"steps/{step:06}/CAM_FRONT/color.png") as file:
                assert total == int(np.asarray(file.convert("RGB")).sum())
    else:
        assert not os.environ.get("PSKEL_NAVSIM")
    # The same rollout gives the same files.
    again = [Path(line) for line in scenes(out, tmp_path / "b", *options).splitlines()]
    for a, b in zip(paths, again, strict=True):
        assert a.name == b.name and a.read_bytes() == b.read_bytes()


def tracks_equal(tracks: Any, row: Any, atol: float = 1e-6) -> None:
    """Tracks of a scene equal the actors of a step; tracks of frames have 32 bits, relative to the ego."""
    assert [track[0] for track in tracks] == [actor["track"] for actor in row["actors"]]
    for (_, kind, x, y, heading, vx, vy), actor in zip(tracks, row["actors"], strict=True):
        np.testing.assert_allclose([x, y], actor["center_m"][:2], atol=atol)
        turn = np.remainder(heading - actor["heading_rad"] + np.pi, 2.0 * np.pi) - np.pi
        assert abs(turn) < max(atol, 1e-6)
        if kind in ("vehicle", "pedestrian", "bicycle"):
            np.testing.assert_allclose([vx, vy], actor["velocity_mps"], atol=atol)


@devkit
def test_mistakes_of_scenes(driven: tuple[Path, Path], tmp_path: Path) -> None:
    out, _ = driven
    for options, expected in (
        (("--map=a", "--steps=14"), "expected a step from 15 to 20, with 8 frames after it, found 14"),
        (("--map=a", "--steps=21"), "expected a step from 15 to 20, with 8 frames after it, found 21"),
        ((), "expected a log with a map of nuPlan, or --map NAME, found none"),
    ):
        assert expected in scenes(out, tmp_path / "x", *options, code=1)
    assert not (tmp_path / "x").exists()
    assert "expected a rollout, found " in scenes(tmp_path, tmp_path / "x", code=1)
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "states.jsonl").write_text((out / "states.jsonl").read_text())
    for name in ("../up", "/up", "..", "a/b"):
        (bad / "rollout.json").write_text(json.dumps({**json.loads((out / "rollout.json").read_text()), "log": name}))
        assert f"expected the name of a log in {bad / 'rollout.json'}, found '{name}'" in scenes(bad, tmp_path / "x", "--map=a", code=1)
    (bad / "states.jsonl").write_text("{}\n")
    assert f"expected the states of a rollout in {bad / 'states.jsonl'}, found KeyError" in scenes(bad, tmp_path / "x", code=1)
