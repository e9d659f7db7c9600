"""Clients of HUGSIM, against one without a network, also in an environment of an older NumPy if PSKEL_DEVKIT_PYTHON names its Python."""

import io
import json
import math
import os
import pickle
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Image = pytest.importorskip("PIL.Image")

from pskel import hugsim
from pskel._nuscenes import CAMERAS
from pskel._planner import PlannerError

CLIENT = Path(__file__).parent / "hugsim_client.py"
PYTHONS = [sys.executable, os.environ.get("PSKEL_DEVKIT_PYTHON", "")]
GREETING = {"protocol": "pskel-planner", "version": 1, "plan_hz": 4.0}


def observation(folder: Path, step: int, **ego: float) -> dict[str, Any]:
    """An observation of cameras of 900x1600, whose images have a gray of their own."""
    folder.mkdir(exist_ok=True)
    intrinsics = [[1266.0, 0.0, 816.0], [0.0, 1260.0, 490.0], [0.0, 0.0, 1.0]]
    mount = [[0.0, 0.0, 1.0, 1.7], [-1.0, 0.0, 0.0, 0.1], [0.0, -1.0, 0.0, 1.5], [0.0, 0.0, 0.0, 1.0]]
    camera = {"width": 1600, "height": 900, "intrinsics": intrinsics, "ego_from_camera": mount}
    (folder / "meta.json").write_text(json.dumps({"cameras": [{"name": name, **camera} for name in CAMERAS]}))
    for index, name in enumerate(CAMERAS):
        (folder / name).mkdir(exist_ok=True)
        Image.new("RGB", (1600, 900), (10 * index, 7, 9)).save(folder / name / "color.png")
    state = {"x": 100.0, "y": 50.0, "z": 0.0, "heading": 0.5, "v": 4.0, "a": 0.5, "yaw_rate": 0.1, "steering": 0.1, **ego}
    return {"type": "observation", "step": step, "t_us": step * 250_000, "driving_command": "right", "ego": state, "files": [str(folder / "meta.json")]}


class Rollout:
    """The bridge and the client as processes."""

    def __init__(self, folder: Path, how: str = "", python: str = sys.executable, client: bool = True) -> None:
        command = [sys.executable, "-m", "pskel.hugsim", str(folder), "--timeout", "3"]
        self.bridge = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.ask(GREETING) == {"protocol": "pskel-planner", "version": 1}
        self.client = subprocess.Popen([python, str(CLIENT), str(folder), how or "none"]) if client else None

    def ask(self, message: dict[str, Any]) -> Any:
        assert self.bridge.stdin is not None and self.bridge.stdout is not None
        print(json.dumps(message), file=self.bridge.stdin, flush=True)
        return json.loads(self.bridge.stdout.readline())

    def end(self) -> int:
        self.bridge.communicate(timeout=30)
        if self.client is not None:
            if self.bridge.returncode:
                self.client.kill()
            self.client.wait(30)
        return self.bridge.returncode


@pytest.mark.parametrize("python", PYTHONS)
def test_a_client_plans(tmp_path: Path, python: str) -> None:
    if not python:
        pytest.skip("needs PSKEL_DEVKIT_PYTHON")
    rollout = Rollout(tmp_path / "pipes", python=python)
    first = rollout.ask(observation(tmp_path / "a", 4))
    # Two meters ahead and one to the left, turned by 0.2.
    forward, left = 2.0, 1.0
    x, y = 100 + forward * math.cos(0.5) - left * math.sin(0.5), 50 + forward * math.sin(0.5) + left * math.cos(0.5)
    second = rollout.ask({**observation(tmp_path / "b", 6, x=x, y=y, heading=0.7, steering=0.3), "driving_command": "unknown"})
    assert rollout.end() == 0 and (tmp_path / "pipes/done").read_text() == "2"
    assert (first["step"], second["step"]) == (4, 6) and [point["t"] for point in first["trajectory"]] == [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    for index, point in enumerate(first["trajectory"], 1):
        right, ahead = 0.5 * index / 6, 2.0 * index
        assert point["x"] == pytest.approx(100 + math.cos(0.5) * ahead + math.sin(0.5) * right)
        assert point["y"] == pytest.approx(50 + math.sin(0.5) * ahead - math.cos(0.5) * right)
    one, two = (json.loads((tmp_path / f"pipes/seen.{n}.json").read_text()) for n in range(2))
    assert one["ego_pos"] == [0, 0, 0] and one["ego_rot"] == [0, 0, 0] and one["timestamp"] == 0 and one["command"] == 0
    assert (one["ego_velo"], one["accelerate"], one["ego_steer"], one["steer_rate"]) == (4.0, 0.5, -0.1, 0.0)
    np.testing.assert_allclose(two["ego_pos"], [-left, 0.0, forward], atol=1e-9)
    np.testing.assert_allclose(two["ego_rot"], [0, -0.2, 0], atol=1e-9)
    assert (two["timestamp"], two["command"]) == (0.5, 2) and two["steer_rate"] == pytest.approx(-0.2 * 4)
    seen = np.load(tmp_path / "pipes/seen.0.npz")
    for index, name in enumerate(CAMERAS):
        assert seen[name].shape == (450, 800, 3) and (seen[name] == [10 * index, 7, 9]).all()
        found = one["intrinsics"][name]
        assert (found["H"], found["W"]) == (450, 800) and [found["cx"], found["cy"]] == pytest.approx([408.0, 245.0])
        # Clients compute focal lengths from fields of view.
        assert [800 / (2 * math.tan(found["fovx"] / 2)), 450 / (2 * math.tan(found["fovy"] / 2))] == pytest.approx([633.0, 630.0])
        # The LiDAR is 0.76 m behind the camera, 0.1 m to its right, and 0.34 m above; its axes are right, forward, up.
        np.testing.assert_allclose(seen[f"{name}.l2c"] @ [0, 0, 0, 1], [0.1, -0.34, -0.76, 1], atol=1e-9)
        np.testing.assert_allclose(seen[f"{name}.l2c"] @ [2, 5, 3, 1], [2.1, -3.34, 4.24, 1], atol=1e-9)


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ("nan", "expected a plan of 1 to 100 finite points [N, 2], found numbers that are not finite"),
        ("shape", "expected a plan of 1 to 100 finite points [N, 2], found [6, 1]"),
        ("long", "expected a plan of at most 65536 bytes, found more"),
        ("none_plan", "expected a plan, found none: the client has failed"),
        ("text", "expected a plan of 1 to 100 finite points [N, 2], found [0]"),
        ("dead", "expected an answer of the client within 3 s, found none"),
        ("silent", "expected an answer of the client within 3 s, found none"),
        ("code", "expected a pickle of numbers, found posix.system, which is not imported"),
        ("objects", "expected a pickle of numbers, found posix.system, which is not imported"),
    ],
)
def test_failures_of_a_client(tmp_path: Path, how: str, expected: str) -> None:
    rollout = Rollout(tmp_path / "pipes", how)
    assert "trajectory" in rollout.ask(observation(tmp_path / "a", 0))
    assert rollout.ask(observation(tmp_path / "a", 1)) == {"error": expected}
    assert rollout.end() == 1
    assert not (tmp_path / "pipes/executed").exists()


def test_what_a_client_needs(tmp_path: Path) -> None:
    rollout = Rollout(tmp_path / "pipes", client=False)
    expected = f"expected a client that reads {tmp_path}/pipes/obs_pipe within 3 s, found none"
    assert rollout.ask(observation(tmp_path / "a", 0)) == {"error": expected} and rollout.end() == 1
    command = [sys.executable, "-m", "pskel.hugsim", str(tmp_path / "pipes")]
    done = subprocess.run(command, input=json.dumps({**GREETING, "plan_hz": 5.0}) + "\n", capture_output=True, text=True, check=False)
    assert json.loads(done.stdout) == {"error": "expected --plan-hz 4, the rate of HUGSIM, found 5"} and done.returncode == 1
    (tmp_path / "file").mkdir()
    (tmp_path / "file/obs_pipe").write_text("mine")
    done = subprocess.run([*command[:3], str(tmp_path / "file")], capture_output=True, text=True, check=False)
    assert done.stderr == f"pskel.hugsim: expected a named pipe, found another file: {tmp_path}/file/obs_pipe\n" and done.returncode == 1


@pytest.mark.parametrize("protocol", [3, 4, 5])
@pytest.mark.parametrize("points", [np.arange(12.0).reshape(6, 2), np.arange(18, dtype=">f4").reshape(6, 3)[:, :2], np.asfortranarray(np.eye(2))])
def test_pickles_of_arrays(protocol: int, points: np.ndarray[Any, Any]) -> None:
    np.testing.assert_array_equal(hugsim.points_of(pickle.dumps(points, protocol)), points)
    np.testing.assert_array_equal(hugsim.points_of(pickle.dumps(points.tolist(), protocol)), points)


@pytest.mark.parametrize("content", [b"", b"\x80\x04.", b"garbage", pickle.dumps(np.zeros((2, 2)))[:-20], pickle.dumps(np.zeros(2, object)), b"(" * 99])
def test_damaged_pickles(content: bytes) -> None:
    with pytest.raises(PlannerError, match="expected a "):
        hugsim.points_of(content)


def test_arrays_are_pickled_for_all_versions() -> None:
    array = np.arange(6, dtype=np.uint8).reshape(2, 3)
    content = hugsim.dumps({"a": array[:, ::-1], "b": [1.0, "x"]})
    assert b"_core" not in content and b"_reconstruct" not in content
    found = pickle.load(io.BytesIO(content))
    np.testing.assert_array_equal(found["a"], array[:, ::-1])


def test_a_client_drives_a_rollout(drive: Path, tmp_path: Path) -> None:
    from conftest import DRIVE

    client = subprocess.Popen(["sh", "-c", f"while [ ! -p pipes/plan_pipe ]; do sleep 0.1; done; exec {sys.executable} {CLIENT} pipes none"], cwd=tmp_path)
    planner = shlex.join([sys.executable, "-m", "pskel.hugsim", str(tmp_path / "pipes")])
    command = [sys.executable, "-m", "pskel", "simulate", DRIVE, f"--skeleton={drive / 'skeleton'}", f"--out={tmp_path / 'out'}", "--steps=24"]
    command += ["--sim-hz=8", "--plan-hz=4", "--maps=color", "--size=90x160", "--ego=external", f"--planner={planner}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, done.stderr
    end_s = time.monotonic() + 10
    while not (tmp_path / "pipes/done").exists() and time.monotonic() < end_s:
        time.sleep(0.1)
    assert (tmp_path / "pipes/done").read_text() == "12"
    client.wait(10)
    seen = [json.loads((tmp_path / f"pipes/seen.{n}.json").read_text()) for n in range(12)]
    np.testing.assert_allclose([see["timestamp"] for see in seen], np.arange(12) / 4, atol=1e-5)
    assert seen[-1]["ego_pos"][2] > 4.0
