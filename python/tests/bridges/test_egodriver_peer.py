"""Rollouts with a driver of another project: the policy route_follower of carla-driver-interface."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("grpc")
pytest.importorskip("carla_driver_interface")

SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
PANDASET = SHARED / "data/pandaset-002/nuscenes"
TOWN = "town:seed=7,frames=40,size=113x200"
SMALL = ["--steps=60", "--size=56x100", "--maps=color", "--driver-timeout=60"]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """Address and log of one server for all rollouts."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = tmp_path_factory.mktemp("server") / "log"
    program = [sys.executable, "-c", "from carla_driver_interface.cli import main; raise SystemExit(main())"]
    options = ["serve", "--policy", "route_follower", "--mode", "alpasim", "--host", "127.0.0.1", "--port", str(port)]
    with log.open("wb") as out:
        process = subprocess.Popen([*program, *options], stdout=out, stderr=out)
        try:
            yield f"127.0.0.1:{port}", log
        finally:
            process.kill()
            process.wait()


def start(log: str, skeleton: Path, out: Path, address: str, *options: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "pskel.egodriver", log, f"--skeleton={skeleton}", f"--out={out}", f"--driver={address}"]
    return subprocess.Popen([*command, *SMALL, *options], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def finish(rollout: "subprocess.Popen[str]", out: Path) -> Any:
    """Metrics of a successful rollout."""
    _, errors = rollout.communicate(timeout=300)
    assert rollout.returncode == 0, errors
    return json.loads((out / "metrics.json").read_text())


def build(log: str, out: Path) -> Path:
    # The policy sees routes, not images: a coarse skeleton of few frames serves as well.
    coarse = ["--frames=0..4", "--voxel=0.2"]
    command = [sys.executable, "-m", "pskel", "build", log, f"--out={out}", *coarse]
    subprocess.run(command, check=True, capture_output=True)
    return out


def test_route_follower_drives_the_town_alone_and_in_four_sessions(server: tuple[str, Path], tmp_path: Path) -> None:
    address, log = server
    skeleton = build(TOWN, tmp_path / "skeleton")
    alone = tmp_path / "alone"
    metrics = finish(start(TOWN, skeleton, alone, address), alone)
    assert (metrics["ended"], metrics["steps"], metrics["collisions"]) == ("steps", 60, [])
    assert metrics["progress_m"] == pytest.approx(47.9, abs=0.5)
    assert metrics["lateral_deviation_m"]["max"] < 0.01 and metrics["heading_deviation_rad"]["max"] < 0.01
    outs = [tmp_path / f"together {i}" for i in range(4)]
    rollouts = [start(TOWN, skeleton, out, address) for out in outs]
    for rollout, out in zip(rollouts, outs, strict=True):
        finish(rollout, out)
        assert (out / "states.jsonl").read_bytes() == (alone / "states.jsonl").read_bytes()
    lines = log.read_text().splitlines()
    sessions = {
        name: {line.split("uuid=")[1].split()[0] for line in lines if f" {name} " in line}
        for name in ("start_session", "close_session")
    }
    assert len(sessions["start_session"]) == 5 and sessions["start_session"] == sessions["close_session"]
    assert not [line for line in lines if "WARNING" in line or "ERROR" in line]


@pytest.mark.skipif(not PANDASET.exists(), reason="pandaset-002 is not there (set PSKEL_SHARED)")
def test_route_follower_drives_a_recorded_log(server: tuple[str, Path], tmp_path: Path) -> None:
    log, out = f"nuscenes:{PANDASET}", tmp_path / "out"
    skeleton = build(log, tmp_path / "skeleton")
    metrics = finish(start(log, skeleton, out, server[0], "--cameras=alpasim", "--encoding=jpeg"), out)
    assert (metrics["ended"], metrics["steps"]) == ("steps", 60)
    # The policy follows the route at 8 m/s and knows no other vehicles.
    assert [(c["kind"], c["at_fault"]) for c in metrics["collisions"]] == [("front", True)]
    assert metrics["progress_m"] == pytest.approx(23.0, abs=0.5)
    assert metrics["lateral_deviation_m"]["max"] < 0.01 and metrics["heading_deviation_rad"]["max"] < 0.01
    assert "camera_front_wide_120fov" in server[1].read_text()
