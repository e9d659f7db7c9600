"""World dreamer and agents of DriveArena, against servers written from their requests and answers."""

import json
import math
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Image = pytest.importorskip("PIL.Image")
pytest.importorskip("safetensors")

sys.path.insert(0, str(Path(__file__).parents[1]))

from drivearena_fakes import Fake, png, serving
from images_client import Client
from pskel._nuscenes import waypoints_of
from pskel.drivearena import CAMERAS
from pskel.drivearena.road_map import RoadMap

COMMAND = [sys.executable, "-m", "pskel.drivearena"]
NAMES = ["CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT"]  # of nuScenes
HELLO = {
    "protocol": "pskel-images", "version": "1", "log": "scene-0061", "seed": "0", "fps": "2.0",
    "condition_size": "256,448", "cameras": json.dumps(NAMES), "image_sizes": json.dumps([[1600, 900]] * 6), "maps": '["color"]',
}  # fmt: skip


def pose(x: float, y: float, heading: float, z: float = 0.0) -> np.ndarray[Any, Any]:
    cos, sin = math.cos(heading), math.sin(heading)
    return np.array([[cos, -sin, 0, x], [sin, cos, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def actor(category: str, box: np.ndarray[Any, Any], class_name: str = "object") -> dict[str, Any]:
    return {"track": category, "category": category, "class": class_name, "size": [4.5, 1.9, 1.6], "global_from_box": box.ravel().tolist()}


def request(frame: int, ego: np.ndarray[Any, Any], actors: list[Any] | None = None, prompt: Any = "rain") -> tuple[dict[str, str], dict[str, Any]]:
    texts = {"ask": "generate", "frame": str(frame), "t_us": json.dumps([frame * 500_000])}
    texts |= {"prompts": json.dumps([prompt]), "actors": json.dumps([actors or []])}
    mounts, intrinsics = np.tile(np.eye(4), (1, 6, 1, 1)), np.tile(np.eye(3), (1, 6, 1, 1))
    return texts, {"global_from_ego": ego[None], "ego_from_camera": mounts, "intrinsics": intrinsics}


class Dreamer:
    """The bridge to a world dreamer as a process."""

    def __init__(self, url: str, *options: str) -> None:
        command = [*COMMAND, "dreamer", "--url", url, *options]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.client = Client(self.process.stdout, self.process.stdin)  # type: ignore[arg-type]
        self.ask = self.client.ask

    def end(self) -> str:
        """Close the connection; returns the standard error."""
        self.client.close()
        errors: str = self.process.stderr.read().decode()  # type: ignore[union-attr]
        self.process.wait(60)
        return errors


@pytest.fixture
def square(tmp_path: Path) -> Path:
    """A map of two overlapping roads with a hole, a divider, and a crossing; in meters of the global frame."""
    corners = {
        "road": [(0, 0), (60, 0), (60, 10), (0, 10)],
        "lane": [(30, -20), (40, -20), (40, 30), (30, 30)],
        "crossing": [(50, 0), (54, 0), (54, 10), (50, 10)],
        "area": [(0, 0), (60, 0), (60, 10), (0, 10)],
        "island": [(10, 4), (14, 4), (14, 6), (10, 6)],
        "divider": [(0, 5), (60, 5)],
    }
    nodes = {name: [f"{name}.{i}" for i in range(len(points))] for name, points in corners.items()}
    polygons = [{"token": name, "exterior_node_tokens": nodes[name], "holes": []} for name in ("road", "lane", "crossing", "area")]
    polygons[3]["holes"] = [{"node_tokens": nodes["island"]}]
    tables = {
        "node": [{"token": f"{name}.{i}", "x": x, "y": y} for name, points in corners.items() for i, (x, y) in enumerate(points)],
        "line": [{"token": "divider", "node_tokens": nodes["divider"]}, {"token": "none", "node_tokens": []}],
        "polygon": polygons,
        "road_divider": [{"line_token": "divider"}],
        "lane_divider": [{"line_token": "none"}],
        "ped_crossing": [{"polygon_token": "crossing"}],
        "road_segment": [{"polygon_token": "road"}],
        "lane": [{"polygon_token": "lane"}],
        "drivable_area": [{"polygon_tokens": ["area"]}],
    }
    (tmp_path / "boston-seaport.json").write_text(json.dumps(tables))
    return tmp_path / "boston-seaport.json"


def length(lines: list[Any]) -> float:
    return sum(float(np.linalg.norm(np.diff(np.array(line), axis=0), axis=1).sum()) for line in lines)


def test_lines_and_area_of_a_map(square: Path) -> None:
    found = RoadMap.load(square)
    labels, lines = found.lines(30.0, 5.0, 0.0)
    by_label = [[line for label, line in zip(labels, lines, strict=True) if label == wanted] for wanted in range(3)]
    assert length(by_label[0]) == pytest.approx(60) and length(by_label[1]) == pytest.approx(28)
    # The union's outline: both rectangles without the edges inside of the other.
    assert length(by_label[2]) == pytest.approx((2 * 60 - 2 * 10 + 2 * 10) + (2 * 50 - 2 * 10 + 2 * 10))
    for line in by_label[2]:
        right, forward = np.array(line).T  # facing east: right is south
        x, y = 30 + forward, 5 - right
        on_road = np.isclose(y, 0) | np.isclose(y, 10) | np.isclose(x, 0) | np.isclose(x, 60)
        on_lane = np.isclose(x, 30) | np.isclose(x, 40) | np.isclose(y, -20) | np.isclose(y, 30)
        assert (on_road | on_lane).all() and not (on_road & (x > 30.01) & (x < 39.99) & (y > 0.01) & (y < 9.99)).any()
    area = found.drivable(30.0, 5.0, 0.0)
    cells = (np.arange(200) + 0.5) / 2 - 50
    x, y = 30 + cells[None, :], 5 - cells[:, None]  # [right, forward]
    inside = (x > 0) & (x < 60) & (y > 0) & (y < 10) & ~((x > 10) & (x < 14) & (y > 4) & (y < 6))
    np.testing.assert_array_equal(area, inside)
    # Turned and moved with the ego: the same part of the street from another place.
    north = found.drivable(30.0, 5.0, math.pi / 2)
    np.testing.assert_array_equal(north, area[::-1].T)
    assert length([line for label, line in zip(*found.lines(0.0, 5.0, 1.0), strict=True) if label == 0]) == pytest.approx(50 / math.sin(1.0), abs=1)


def test_images_of_a_world_dreamer(square: Path) -> None:
    first, second = pose(20.0, 5.0, 0.3), pose(22.0, 5.5, 0.4)
    # A car 10 m ahead and 3 m to the left of the ego, which turns by 0.2, and others.
    box = first @ pose(10.0, 3.0, 0.2, z=0.8)
    actors = [
        actor("vehicle.car", box), actor("vehicle.bus.bendy", first @ pose(-20, 0, 0)), actor("vehicle.construction", first),
        actor("human.pedestrian.construction_worker", first), actor("movable_object.trafficcone", first), actor("tram", first, "motor_vehicle"),
        actor("animal", first), actor("animal", first), actor("vehicle.car", first @ pose(60, 0, 0)),
    ]  # fmt: skip
    with serving() as server:
        bridge = Dreamer(server.url, "--map", str(square))
        answer, _ = bridge.ask(HELLO)
        assert (answer["image_size"], answer["maps"], answer["references"], answer["forecasts"]) == ("224,400", "[]", "0", "0")
        for frame, ego in enumerate((first, second)):
            texts, made = bridge.ask(*request(frame, ego, actors))
            assert texts == {"frame": str(frame)} and made["images"].shape == (6, 224, 400, 3)
            expected = [10 * CAMERAS.index(name) + frame for name in NAMES]
            assert made["images"].reshape(6, -1).min(axis=1).tolist() == made["images"].reshape(6, -1).max(axis=1).tolist() == expected
        errors = bridge.end()
        assert errors == "pskel.drivearena: actors of animal have no class of the world dreamer and are left out\n"
        assert bridge.process.returncode == 0 and server.cleaned == 1
        one, two = server.requests
    assert one["metas"]["location"] == "boston-seaport" and one["metas"]["description"] == "rain"
    np.testing.assert_allclose(one["relative_pose"], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(two["relative_pose"], np.linalg.inv(second) @ first, atol=1e-9)
    np.testing.assert_allclose(two["metas"]["ego_pos"], second)
    assert one["gt_labels_3d"] == [0, 3, 2, 8, 9, 0]
    # The LiDAR is 0.94 m ahead of the ego and 1.84 m up; x is right, y forward, and the yaw -heading - 90 degrees.
    np.testing.assert_allclose(one["gt_bboxes_3d"][0][:6], [-3.0, 10.0 - 0.94, 0.8 - 1.84, 1.9, 4.5, 1.6], atol=1e-9)
    assert one["gt_bboxes_3d"][0][6] == pytest.approx(math.remainder(-(math.pi / 2 + 0.2) - math.pi / 2, math.tau))
    assert one["gt_bboxes_3d"][0][7:] == [0, 0]
    x, y = 20 + 0.94 * math.cos(0.3), 5 + 0.94 * math.sin(0.3)
    labels, lines = RoadMap.load(square).lines(x, y, 0.3)
    assert one["gt_vecs_label"] == labels and set(labels) == {0, 1, 2}
    for sent, line in zip(one["gt_lines_instance"], lines, strict=True):
        np.testing.assert_allclose(sent, line, atol=1e-9)
    assert np.array(one["drivable_mask"]).sum() * 0.25 == pytest.approx(60 * 10 - 8, rel=0.02)


@pytest.mark.parametrize(
    ("fails", "expected"),
    [
        ("status", "expected an answer of POST URL/dreamer-api/, found status 500: Internal Server Error: CUDA out of memory"),
        ("hang", "expected an answer of POST URL/dreamer-api/ within 1 s, found none"),
        ("slow", "expected an answer of POST URL/dreamer-api/ within 1 s, found none"),
        ("text", "expected a PNG of the world dreamer, found text/html: b'<html>busy</html>'"),
        ("size", "expected images of the world dreamer of 1344x400 in all, found 1344x200"),
        ("cut", "expected a PNG of the world dreamer, found "),
        ("short", "expected an answer of POST URL/dreamer-api/, found "),
    ],
)
def test_failures_of_a_world_dreamer(fails: str, expected: str) -> None:
    with serving(fails, after=1) as server:
        bridge = Dreamer(server.url, "--timeout", "1")
        bridge.ask(HELLO)
        assert bridge.ask(*request(0, pose(0, 0, 0)))[0] == {"frame": "0"}
        said = bridge.ask(*request(1, pose(0, 0, 0)))[0]["error"]
        assert said.startswith(expected.replace("URL", server.url)), said
        errors = bridge.end()
    warning, line = errors.splitlines()
    assert warning == "pskel.drivearena: without --map the world dreamer gets no lines and no drivable area"
    assert " ".join(line.split()) == f"pskel.drivearena: {said}" and bridge.process.returncode == 1


@pytest.mark.parametrize(
    ("hello", "sent", "options", "expected"),
    [
        ({"fps": "5"}, None, [], "expected --plan-hz 2, the rate of DriveArena's world dreamer, found 5"),
        ({"cameras": '["CAM_FRONT"]', "image_sizes": "[[1600, 900]]"}, None, [], f"expected the cameras {', '.join(CAMERAS)}, found CAM_FRONT"),
        ({}, request(7, pose(0, 0, 0)), [], "expected frame 0 of a rollout, found 7: the world dreamer keeps its last images itself"),
        ({}, request(0, pose(0, 0, 0), prompt=list("abcdef")), [], "expected one text for all cameras, found 6 captions: use --description"),
        ({}, request(0, pose(900, 0, 0)), ["--map"], "expected a map of the log's place, found nothing within 50 m of 900.9, 0.0"),
    ],
)
def test_what_a_world_dreamer_needs(square: Path, hello: dict[str, str], sent: Any, options: list[str], expected: str) -> None:
    with serving() as server:
        bridge = Dreamer(server.url, *(option for given in options for option in (given, str(square))))
        answer = bridge.ask({**HELLO, **hello})[0]
        answer = bridge.ask(*sent)[0] if sent else answer
        assert answer["error"].startswith(expected), answer
        assert bridge.end() and bridge.process.returncode == 1 and not server.requests


def test_descriptions_and_addresses(square: Path) -> None:
    with serving() as server:
        bridge = Dreamer(server.url, "--description", "sunny", "--location", "here")
        bridge.ask(HELLO)
        bridge.ask(*request(0, pose(0, 0, 0), prompt=list("abcdef")))
        bridge.end()
        assert server.requests[0]["metas"]["description"] == "sunny" and server.requests[0]["metas"]["location"] == "here"
    bridge = Dreamer(server.url)  # it has ended
    assert bridge.ask(HELLO)[0]["error"].startswith(f"expected an answer of GET {server.url}/dreamer-clean/, found ")
    for options, expected in (
        (["--url", "file:///etc/passwd"], "pskel.drivearena: expected --url http://HOST:PORT, found file:///etc/passwd"),
        (["--url", server.url, "--map", "none.json"], "pskel.drivearena: expected a map expansion of nuScenes in none.json, found "),
        (["--url", server.url, "--map", __file__], f"pskel.drivearena: expected a map expansion of nuScenes in {__file__}, found "),
    ):
        done = subprocess.run([*COMMAND, "dreamer", *options], capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
        assert done.returncode == 1 and done.stderr.startswith(expected) and len(done.stderr.splitlines()) == 1


class Planner:
    """The bridge to an agent as a process."""

    def __init__(self, url: str, *options: str) -> None:
        command = [*COMMAND, "agent", "--url", url, *options]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def ask(self, message: dict[str, Any]) -> Any:
        assert self.process.stdin is not None and self.process.stdout is not None
        print(json.dumps(message), file=self.process.stdin, flush=True)
        return json.loads(self.process.stdout.readline())

    def end(self) -> int:
        self.process.communicate()
        return self.process.returncode


def observation(folder: Path, size: tuple[int, int] = (224, 400), step: int = 5, **ego: float) -> dict[str, Any]:
    """An observation with an image of its own for each camera."""
    folder.mkdir(exist_ok=True)
    (folder / "meta.json").write_text("{}")
    for index, name in enumerate(CAMERAS):
        (folder / name).mkdir(exist_ok=True)
        (folder / name / "color.png").write_bytes(png(np.full((*size, 3), 10 * index + 3)))
    state = {"x": 1000.4, "y": -20.6, "z": 0.0, "heading": 0.5, "v": 4.0, "a": 0.5, "yaw_rate": 0.1, "steering": 0.0, **ego}
    files = [str(folder / "meta.json"), *(str(folder / name / "color.png") for name in CAMERAS)]
    return {"type": "observation", "step": step, "t_us": step * 500_000, "plan_dt": 0.5, "driving_command": "left", "ego": state, "files": files}


GREETING = {"protocol": "pskel-planner", "version": 1, "plan_hz": 2.0}


@pytest.mark.parametrize("agent", ["uniad", "vad"])
def test_an_agent_plans(tmp_path: Path, agent: str) -> None:
    with serving(agent=agent) as server:
        planner = Planner(server.url)
        assert planner.ask(GREETING) == {"protocol": "pskel-planner", "version": 1}
        first = planner.ask(observation(tmp_path))
        planner.ask({**observation(tmp_path, (900, 1600), step=6, x=1002.0, y=-19.0), "driving_command": "right"})
        assert planner.end() == 0
        one, two = server.requests
    assert (server.cleaned, one["timestamp"], two["timestamp"], one["command"], two["command"]) == (1, 0.0, 0.5, 1, 0)
    for sent in (one, two):
        assert (sent["images"] == (10 * np.arange(6) + 3)[:, None, None, None]).all()
    cos, sin = math.cos(0.5), math.sin(0.5)
    np.testing.assert_allclose(one["ego_pose"], [[cos, -sin, 0, 0.4], [sin, cos, 0, 0.4], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(np.array(two["ego_pose"])[:2, 3], [2.0, 2.0])
    np.testing.assert_allclose([*one["accel"], *one["rotation_rate"], *one["vel"]], [0.5, 0.4, 9.8, 0, 0, 0.1, 4, 0, 0])
    assert first["step"] == 5 and [point["t"] for point in first["trajectory"]] == [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    for index, point in enumerate(first["trajectory"], 1):
        forward, left = 2.0 * index, -0.5 * index / 6
        assert point["x"] == pytest.approx(1000.4 + cos * forward - sin * left)
        assert point["y"] == pytest.approx(-20.6 + sin * forward + cos * left)
        assert point["heading"] == pytest.approx(0.5 - math.atan2(0.5 / 6, 2.0))
        assert point["v"] == pytest.approx(math.hypot(4.0, 1 / 6))


def test_headings_of_slow_and_backward_plans() -> None:
    ego = {"x": 0.0, "y": 0.0, "heading": 3.0}
    still = waypoints_of(np.array([[0.0, 0.0], [0.01, 0.02]]), ego)
    assert [point["heading"] for point in still] == [3.0, 3.0]
    back = waypoints_of(np.array([[0.0, -1.0], [0.0, -2.0]]), ego)
    assert [point["heading"] for point in back] == pytest.approx([3.0, 3.0]) and [point["v"] for point in back] == pytest.approx([-2.0, -2.0])
    right = waypoints_of(np.array([[0.0, 1.0], [1.0, 1.0]]), ego)
    assert right[1]["heading"] == pytest.approx(3.0 - math.pi / 2)


@pytest.mark.parametrize(
    ("fails", "expected"),
    [
        ("status", "expected an answer of POST URL/driver-api/, found status 500: Internal Server Error: CUDA out of memory"),
        ("hang", "expected an answer of POST URL/driver-api/ within 1 s, found none"),
        ("silent", "expected a plan of the agent within 1 s, found none"),
        ("nan", "expected planning_traj of 1 to 100 finite points [N, 2], found numbers that are not finite"),
        ("shape", "expected planning_traj of 1 to 100 finite points [N, 2], found [6, 3]"),
        ("unasked", "expected an agent without plans before it is asked, found one: does a world dreamer send it images (--agent_port)?"),
    ],
)
def test_failures_of_an_agent(tmp_path: Path, fails: str, expected: str) -> None:
    with serving(fails) as server:
        planner = Planner(server.url, "--timeout", "1")
        planner.ask(GREETING)
        assert planner.ask(observation(tmp_path)) == {"error": expected.replace("URL", server.url)}
        assert planner.end() == 1


def test_what_an_agent_needs(tmp_path: Path) -> None:
    with serving() as server:
        planner = Planner(server.url)
        assert planner.ask({**GREETING, "plan_hz": 5.0}) == {"error": "expected --plan-hz 2, the rate of DriveArena's agents, found 5"}
        for see, expected in (
            (observation(tmp_path / "a", (224, 224)), "expected images of 224x400, or of the aspect of 900x1600, found 224x224 of CAM_FRONT_LEFT"),
            ({**observation(tmp_path / "b"), "files": []}, "expected images of the cameras, found none: simulate without --dry"),
        ):
            planner = Planner(server.url)
            planner.ask(GREETING)
            assert planner.ask(see) == {"error": expected}
        (tmp_path / "a" / "CAM_BACK" / "color.png").unlink()
        planner = Planner(server.url)
        planner.ask(GREETING)
        see = observation(tmp_path / "a")
        (tmp_path / "a" / "CAM_BACK" / "color.png").unlink()
        assert planner.ask(see)["error"].startswith(f"expected an image in {tmp_path}/a/CAM_BACK/color.png, found ")
        assert not server.requests


def simulate(drive: Path, out: Path, server: Fake, *options: str, code: int = 0) -> str:
    from conftest import DRIVE

    planner = shlex.join([*COMMAND, "agent", "--url", server.url])
    command = [sys.executable, "-m", "pskel", "simulate", DRIVE, f"--skeleton={drive / 'skeleton'}", f"--out={out}", "--steps=40"]
    command += ["--sim-hz=10", "--plan-hz=2", "--maps=color", "--size=225x400", "--ego=external", f"--planner={planner}"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == code, done.stderr
    return done.stderr


def test_an_agent_drives_a_rollout(drive: Path, tmp_path: Path) -> None:
    with serving() as server:
        simulate(drive, tmp_path / "whole", server)
        assert len(server.requests) == 8
    with serving("status", after=4) as server:
        errors = simulate(drive, tmp_path / "out", server, code=1)
        assert "found status 500: Internal Server Error: CUDA out of memory" in errors
        server.fails = ""
        simulate(drive, tmp_path / "out", server, "--resume")
        assert server.cleaned == 2
    rows = [json.loads(line) for line in (tmp_path / "whole/states.jsonl").read_text().splitlines()]
    local = np.linalg.inv(np.array(rows[0]["ego"]["global_from_ego"])) @ np.array(rows[5]["ego"]["global_from_ego"])
    np.testing.assert_allclose(local[:2, 3], [2.0, -0.5 / 6], atol=2e-3)
    assert (tmp_path / "out/states.jsonl").read_bytes() == (tmp_path / "whole/states.jsonl").read_bytes()
