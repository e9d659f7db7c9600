"""Planners of nuplan-devkit in rollouts: what they see, how they drive, and how they fail.

The devkit needs an environment of its own: its Python is named by PSKEL_DEVKIT_PYTHON. Its folder lies in the
shared data.
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
DEVKIT = SHARED / "interop/nuplan-devkit"
PANDASET = SHARED / "data/pandaset-002/nuplan"
PYTHON = os.environ.get("PSKEL_DEVKIT_PYTHON")
TESTS = Path(__file__).parent
DATABASE = "nuplan-v1.1/splits/mini/2020.01.01.00.00.00_veh-02_00000_00079.db"
#: The log starts at 1557539956450022 us; half a second later there is history, and 4 s later there is still a log.
START_US = 1557539957450022

pytestmark = pytest.mark.skipif(
    PYTHON is None or not DEVKIT.exists() or not PANDASET.exists(), reason="needs PSKEL_DEVKIT_PYTHON and the shared data"
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log with a writable folder of maps, beside which the devkit locks."""
    root = tmp_path_factory.mktemp("nuplan")
    shutil.copytree(PANDASET, root, dirs_exist_ok=True)
    subprocess.run([sys.executable, "-m", "pskel", "build", f"nuplan:{root / DATABASE}", f"--out={root / 'skeleton'}"], check=True)
    return root


def planner(kind: str, seen: Path) -> str:
    """The command of the recorder. It runs from the source tree, since the devkit's environment has no wheel."""
    path = os.pathsep.join(str(folder) for folder in (TESTS.parents[1], TESTS, DEVKIT))
    arguments = json.dumps({"kind": kind, "seen": str(seen)})
    return f"PYTHONPATH={path} {PYTHON} -m pskel.nuplan_planner nuplan_recorder:Recorder --args {shlex.quote(arguments)}"


def simulate(log: Path, out: Path, planner: str, *options: str, steps: int = 40, code: int = 0, fails: str = "", timeout_s: int = 60) -> str:
    """A rollout at 10 Hz with a plan at each step; returns its errors."""
    command = [sys.executable, "-m", "pskel", "simulate", f"nuplan:{log / DATABASE}", f"--skeleton={log / 'skeleton'}"]
    command += [f"--out={out}", f"--steps={steps}", f"--start={START_US}", "--sim-hz=10", "--plan-hz=10", "--size=45x80"]
    command += ["--maps=class", "--ego=external", f"--planner={planner}", f"--planner-timeout={timeout_s}", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env={**os.environ, "FAILS": fails})
    assert done.returncode == code, done.stderr
    return done.stderr


def lines(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def close(a: Any, b: Any) -> None:
    assert a == pytest.approx(b, abs=1e-6, rel=0)


@pytest.mark.parametrize("kind", ["simple", "idm"])
def test_planners_of_the_devkit_drive(log: Path, tmp_path: Path, kind: str) -> None:
    out, seen = tmp_path / "out", tmp_path / "seen"
    simulate(log, out, planner(kind, seen))
    about, *observations = lines(seen)
    rows = lines(out / "states.jsonl")
    metrics = json.loads((out / "metrics.json").read_text())
    assert (metrics["ended"], metrics["steps"], len(rows)) == ("steps", 40, 41)
    assert (about["route"], about["map"]) == (["66001", "69001", "66004"], "us-ca-pandaset-002")
    assert [see["index"] for see in observations] == list(range(40))
    for step, see in enumerate(observations):
        # A second of the log before the start, then all committed states of the last 2 s.
        past = see["states"][:-1]
        assert [state["t_us"] for state in past[-step:]] == [row["t_us"] for row in rows[max(step - 20, 0) : step]] or step == 0
        assert len(past) == min(10 + step, 20)
        assert see["t_us"] == see["states"][-1]["t_us"] == rows[step]["t_us"] and see["interval"] == 0.1
        for state, row in zip(see["states"][-min(step + 1, 21) :], rows[max(step - 20, 0) : step + 1], strict=True):
            same(state, row)
        assert see["lights"] == [[int(l["lane_connector"]), l["color"].upper(), see["t_us"]] for l in rows[step]["lights"]]
        assert len(see["lights"]) == 4
    # SimplePlanner speeds up by 1 m/s^2 and goes straight, IDMPlanner drives along its lane.
    assert metrics["progress_m"] > 5.0 and metrics["collisions"] == []
    assert metrics["lateral_deviation_m"]["max"] < 0.5
    if kind == "simple":
        assert max(abs(row["ego"]["yaw_rate_radps"]) for row in rows) < 1e-2
        assert rows[-1]["ego"]["speed_mps"] == pytest.approx(4.0, abs=0.3)
    # Plans of the same waypoints from another planner give the same rollout, byte for byte.
    replay = tmp_path / "replay.py"
    replay.write_text(REPLAY)
    simulate(log, tmp_path / "again", f"{sys.executable} {replay} {out / 'states.jsonl'}")
    assert (tmp_path / "again/states.jsonl").read_bytes() == (out / "states.jsonl").read_bytes()


#: A planner that answers the plans in the states of a rollout.
REPLAY = """
import json, sys
plans = {}
for row in map(json.loads, open(sys.argv[1])):
    if row["plan"]:
        start, *waypoints = row["plan"]
        plans[start["t_us"]] = [
            {"t": (w["t_us"] - start["t_us"]) / 1e6, "x": w["x_m"], "y": w["y_m"], "heading": w["heading_rad"], "v": w["speed_mps"]}
            for w in waypoints]
for see in map(json.loads, sys.stdin):
    answer = {"trajectory": plans[see["t_us"]]} if "type" in see else {"protocol": "pskel-planner", "version": 1}
    print(json.dumps(answer), flush=True)
"""


def same(state: Any, row: Any) -> None:
    """A state of a planner equals the committed one."""
    ego = row["ego"]
    close(state["pose"], [ego["global_from_ego"][0][3], ego["global_from_ego"][1][3], ego["heading_rad"]])
    close(state["motion"], [ego[k] for k in ("speed_mps", "acceleration_mps2", "yaw_rate_radps", "steering_rad")])
    assert [track["track"] for track in state["tracks"]] == [actor["track"] for actor in row["actors"]]
    for track, actor in zip(state["tracks"], row["actors"], strict=True):
        close(track["box"], [*actor["center_m"][:2], actor["heading_rad"], *actor["size_m"]])
        assert track["kind"] == actor["category"]
        agent = track["kind"] in ("vehicle", "pedestrian", "bicycle")
        close(track["velocity"], actor["velocity_mps"] if agent else [0.0, 0.0])


@pytest.mark.parametrize(
    ("fails", "expected"),
    [
        ("raises", 'found the error "RuntimeError: no checkpoint line 2"'),
        ("not finite", 'found the error "ValueError: '),
        ("short", "expected a trajectory of at least 0.1 s from the planner, found one of 0.05 s"),
        ("dies", "planner"),
        ("hangs", "planner"),
    ],
)
def test_failures_keep_what_was_committed(log: Path, tmp_path: Path, fails: str, expected: str) -> None:
    seen, out = tmp_path / "seen", tmp_path / "out"
    errors = simulate(log, out, planner("simple", seen), steps=8, code=1, fails=fails, timeout_s=20)
    assert expected in errors and "error: stopped after" in errors, errors
    before = lines(out / "states.jsonl")
    simulate(log, out, planner("simple", seen), "--resume", steps=8, timeout_s=20)
    after = lines(out / "states.jsonl")
    assert 0 < len(before) < len(after) == 9 and after[: len(before)] == before


def test_mistakes_of_the_command(log: Path, tmp_path: Path) -> None:
    good = planner("simple", tmp_path / "seen")
    for wrong, expected in (
        (good.replace("nuplan_recorder:Recorder", "nuplan_recorder:Nobody"), "expected MODULE:CLASS, found nuplan_recorder:Nobody"),
        (good.replace("nuplan_recorder:Recorder", "nowhere"), "expected MODULE:CLASS, found nowhere"),
        (good + " --map-version x", "expected an index of maps in "),
    ):
        assert expected in simulate(log, tmp_path / "out", wrong, code=1)
        assert not (tmp_path / "out/states.jsonl").exists()
