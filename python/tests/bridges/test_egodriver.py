"""Rollouts with drivers of AlpaSim: messages to a driver, exact plans, and every failure of a driver."""

import io
import json
import math
import os
import re
import shlex
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DRIVE

pytest.importorskip("grpc")
from egodriver_fakes import CHANGES, FakeDriver, served  # noqa: E402
from pskel.alpasim import common_pb2, poses  # noqa: E402
from pskel.egodriver import DriverError, cameras, frames, launch, planner  # noqa: E402
from pskel.egodriver.__main__ import parser  # noqa: E402

HELLO = {"protocol": "pskel-planner", "version": 1, "log": "a town", "seed": 5, "sim_hz": 10.0, "plan_hz": 5.0, "step": 0}
OPTIONS = planner.Options("", 10.0, "auto", "png", "all")
#: A planner that answers the waypoints of FakeDriver, without a driver.
SAME = """
import json, math, sys
origin = None
for see in map(json.loads, sys.stdin):
    answer = {"protocol": "pskel-planner", "version": 1}
    if see.get("type") == "observation":
        at = (see["ego"]["x"], see["ego"]["y"])
        origin = origin or [math.floor(c) for c in at]
        x0, y0 = (round((c - o) * 8) / 8 + o for c, o in zip(at, origin))
        known = [(0, *at)] + [(i * 100000, x0 + 0.5 * i, y0) for i in range(1, 9)]
        answer = {"trajectory": []}
        for i in range(1, 9):
            (t0, xa, _), (t1, xb, _) = known[i - 1], known[min(i + 1, 8)]
            answer["trajectory"].append(
                {"t": known[i][0] / 1e6, "x": known[i][1], "y": y0, "heading": 0.0, "v": (xb - xa) / (t1 / 1e6 - t0 / 1e6)})
    print(json.dumps(answer), flush=True)
"""


def command(drive: Path, out: Path, address: str, *options: str, steps: int = 8) -> list[str]:
    """A rollout of DRIVE with small images."""
    rollout = [DRIVE, f"--skeleton={drive / 'skeleton'}", f"--out={out}", f"--steps={steps}", "--size=56x100"]
    return [sys.executable, "-m", "pskel.egodriver", *rollout, "--maps=color", f"--driver={address}", *options]


def call(*command: str, code: int = 0) -> str:
    """Run a command, which ends with a code; returns its errors."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == code, done.stderr
    return done.stderr


def states(out: Path) -> list[Any]:
    return [json.loads(line) for line in (out / "states.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def seen(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[FakeDriver, Path]:
    """A driver after a rollout of 8 steps (the first 4 follow the log), and the rollout folder."""
    out = tmp_path_factory.mktemp("seen") / "out"
    driver = FakeDriver()
    with served(driver) as address:
        call(*command(drive, out, address, "--warmup=3", "--seed=5", "--cameras=CAM_BACK,CAM_FRONT=camera_front"))
    return driver, out


def test_a_driver_receives_everything_in_order(seen: tuple[FakeDriver, Path]) -> None:
    driver, out = seen
    names = {"submit_image_observation": "i", "submit_egomotion_observation": "e", "submit_route": "r", "drive": "d"}
    assert [driver.calls[0], driver.calls[1], driver.calls[-1]] == ["get_version", "start_session", "close_session"]
    assert "".join(names[name] for name in driver.calls[2:-1]) == "iiiiiierd" + "iierd"
    start = driver.of("start_session")[0]
    assert len({request.session_uuid for request in driver.requests[1:]}) == 1 and len(start.session_uuid) == 36
    assert (start.random_seed, start.debug_info.scene_id) == (5, "town-7-12f-overcast")
    rows = states(out)
    drives = driver.of("drive")
    assert [d.time_now_us for d in drives] == [rows[4]["t_us"], rows[6]["t_us"]]
    assert [d.time_query_us - d.time_now_us for d in drives] == [200_000, 200_000]
    sent = [(i.camera_image.logical_id, i.camera_image.frame_end_us) for i in driver.of("submit_image_observation")]
    assert sent == [(name, rows[step]["t_us"]) for step in (0, 2, 4, 6) for name in ("CAM_BACK", "camera_front")]
    for image in driver.of("submit_image_observation"):
        step = next(row["step"] for row in rows if row["t_us"] == image.camera_image.frame_start_us)
        name = image.camera_image.logical_id.replace("camera_front", "CAM_FRONT")
        assert image.camera_image.image_bytes == (out / f"steps/{step:06}/{name}/color.png").read_bytes()


def test_poses_and_routes_have_the_frames_of_alpasim(seen: tuple[FakeDriver, Path]) -> None:
    driver, out = seen
    rows = states(out)
    motions = driver.of("submit_egomotion_observation")
    assert [len(m.trajectory.poses) for m in motions] == [len(m.dynamic_states) for m in motions] == [5, 2]
    origin = np.floor(np.array(rows[0]["ego"]["global_from_ego"])[:3, 3])
    poses = [pose for motion in motions for pose in motion.trajectory.poses]
    for row, pose in zip(rows, poses, strict=False):
        matrix = np.array(row["ego"]["global_from_ego"])
        assert pose.timestamp_us == row["t_us"]
        vec, q = pose.pose.vec, pose.pose.quat
        np.testing.assert_allclose([vec.x, vec.y, vec.z], matrix[:3, 3] - origin, atol=1e-5)
        assert max(abs(vec.x), abs(vec.y)) < 10.0
        np.testing.assert_allclose(rotation(q), matrix[:3, :3], atol=1e-6)
    for row, state in zip(rows, [s for m in motions for s in m.dynamic_states], strict=False):
        ego = row["ego"]
        assert state.linear_velocity.x == pytest.approx(ego["speed_mps"], rel=1e-6)
        assert state.angular_velocity.z == pytest.approx(ego["yaw_rate_radps"], rel=1e-6)
        assert state.linear_acceleration.x == pytest.approx(ego["acceleration_mps2"], rel=1e-6)
        assert state.linear_acceleration.y == pytest.approx(ego["speed_mps"] * ego["yaw_rate_radps"], rel=1e-6)
    route = driver.of("submit_route")[0].route
    assert route.timestamp_us == rows[4]["t_us"]
    ahead = [(w.x, w.y, w.z) for w in route.waypoints]
    assert len(ahead) > 5 and abs(ahead[0][0]) < 1e-3 and ahead[5][0] == pytest.approx(5.0, abs=0.01)
    assert all(abs(y) < 0.1 and z == 0.0 for _, y, z in ahead)


def rotation(q: common_pb2.Quat) -> Any:
    """Rotation ``[3, 3]`` of a quaternion, by rotating the axes."""
    u, w = np.array([q.x, q.y, q.z]), q.w
    return np.stack([2 * (u @ e) * u + (w * w - u @ u) * e + 2 * w * np.cross(u, e) for e in np.eye(3)], axis=1)


def test_cameras_have_optical_frames_and_the_size_of_their_images(seen: tuple[FakeDriver, Path]) -> None:
    driver, out = seen
    declared = {c.logical_id: c for c in driver.of("start_session")[0].rollout_spec.vehicle.available_cameras}
    assert list(declared) == ["camera_front", "CAM_BACK"]
    meta = json.loads((out / "steps/000000/meta.json").read_text())["cameras"]
    for logical, name in (("camera_front", "CAM_FRONT"), ("CAM_BACK", "CAM_BACK")):
        camera, known = declared[logical], next(c for c in meta if c["name"] == name)
        spec, pinhole = camera.intrinsics, camera.intrinsics.opencv_pinhole_param
        assert (spec.logical_id, spec.resolution_h, spec.resolution_w) == (logical, 56, 100)
        assert [pinhole.focal_length_x, pinhole.principal_point_x] == [known["intrinsics"][0][i] for i in (0, 2)]
        assert [pinhole.focal_length_y, pinhole.principal_point_y] == [known["intrinsics"][1][i] for i in (1, 2)]
        assert list(pinhole.radial_coeffs) + list(pinhole.tangential_coeffs) == [0.0] * 8
        mount, pose = np.array(known["ego_from_camera"]), camera.rig_to_camera
        np.testing.assert_allclose([pose.vec.x, pose.vec.y, pose.vec.z], mount[:3, 3], atol=1e-6)
        np.testing.assert_allclose(rotation(pose.quat), mount[:3, :3], atol=1e-6)
    front = rotation(declared["camera_front"].rig_to_camera.quat)
    np.testing.assert_allclose(front @ [0, 0, 1], [1, 0, 0], atol=1e-6)  # the optical axis is forward
    np.testing.assert_allclose(front @ [1, 0, 0], [0, -1, 0], atol=1e-6)  # x is to the right


def test_quaternions_of_all_rotations() -> None:
    random = np.random.default_rng(1)
    turns = [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1]), np.eye(3)]
    for q in random.normal(size=(200, 4)):
        turns.append(rotation(common_pb2.Quat(**dict(zip("wxyz", (q / np.linalg.norm(q)).tolist(), strict=True)))))
    for turn in turns:
        w, x, y, z = poses.quaternion(turn)
        assert w >= 0.0 and math.hypot(w, x, y, z) == pytest.approx(1.0)
        np.testing.assert_allclose(rotation(common_pb2.Quat(w=w, x=x, y=y, z=z)), turn, atol=1e-6)


def test_routes_on_slopes_are_above_or_below_the_path() -> None:
    pitch, yaw = 0.1, 2.0
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    tilt = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn @ tilt, (100.0, 200.0, 3.0)
    path = [[100.0, 200.0], [101.0, 202.0], [90.0, 250.0]]
    points = np.array([[p.x, p.y, p.z] for p in frames.route(path, matrix)])
    np.testing.assert_allclose((points @ matrix[:3, :3].T + matrix[:3, 3])[:, :2], path, atol=1e-4)
    assert frames.route([], matrix) == []


def test_plans_equal_those_of_another_planner_byte_for_byte(drive: Path, tmp_path: Path) -> None:
    """Also after a resume, and with the launcher's planner given by hand."""
    script = tmp_path / "same.py"
    script.write_text(SAME)
    python = shlex.quote(sys.executable)
    rollout = [DRIVE, f"--skeleton={drive / 'skeleton'}", "--size=56x100", "--maps=color"]
    simulate = [sys.executable, "-m", "pskel", "simulate", *rollout, "--ego=external"]
    call(*simulate, f"--out={tmp_path / 'same'}", "--steps=8", f"--planner={python} {shlex.quote(str(script))}")
    with served(FakeDriver()) as address:
        call(*command(drive, tmp_path / "whole", address))
        call(*command(drive, tmp_path / "parts", address, steps=3))
        by_hand = f"{python} -m pskel.egodriver --driver {address} --images color"
        call(*simulate, f"--out={tmp_path / 'by hand'}", "--steps=8", f"--planner={by_hand}")
    with served(FakeDriver()) as address:  # another port
        call(*command(drive, tmp_path / "parts", address, "--resume"))
    expected = (tmp_path / "same/states.jsonl").read_bytes()
    assert states(tmp_path / "same")[-1]["ego"]["speed_mps"] == pytest.approx(5.0, abs=0.5)
    for name in ("whole", "parts", "by hand"):
        assert (tmp_path / name / "states.jsonl").read_bytes() == expected, name


@pytest.fixture
def recorded(seen: tuple[FakeDriver, Path]) -> tuple[list[str], Path]:
    """The messages of the planning steps of ``seen``, and its folder."""
    _, out = seen
    lines = [json.dumps(HELLO)]
    for row in states(out)[4:7:2]:
        (x, y), files = np.array(row["ego"]["global_from_ego"])[:2, 3].tolist(), [str(out / f"steps/{row['step']:06}/meta.json")]
        see = {"type": "observation", "step": row["step"], "t_us": row["t_us"], "plan_dt": 0.2, "ego": {"x": x, "y": y}}
        lines.append(json.dumps({**see, "path": [[x, y], [x + 1, y]], "files": files}))
    return lines, out


def plans(capsys: pytest.CaptureFixture[str], lines: list[str], **options: Any) -> tuple[int, list[Any], list[str]]:
    """Exit code, answers and errors of a planner."""
    capsys.readouterr()
    out = io.StringIO()
    code = planner.run(replace(OPTIONS, **options), lines, out)
    printed = capsys.readouterr().err.splitlines()  # also by the server, which is in this process
    errors = [line for line in printed if line.startswith("pskel.egodriver: ") and "API 0.54.0" not in line]
    return code, [json.loads(line) for line in out.getvalue().splitlines()], errors


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            "not finite",
            r"expected finite positions and unit quaternions, found \(nan, .*\) and \(1, 0, 0, 0\) at pose 3 \(step 6\)",
        ),
        ("without quaternion", r"expected finite .* and \(0, 0, 0, 0\) at pose 2 \(step 6\)"),
        ("empty", r"expected a trajectory of at least 0.2 s, found none \(step 6\)"),
        ("short", r"expected a trajectory of at least 0.2 s, found one of 0.1 s \(step 6\)"),
        ("backwards", r"expected a trajectory with rising times, found \d+ us after \d+ us at pose 4 \(step 6\)"),
        ("other session", r"expected an answer to drive, found NOT_FOUND: Unknown session [0-9a-f-]{36} line 2"),
        ("poses", r"expected a trajectory of at most 10000 poses, found 10009 \(step 6\)"),
        ("bytes", r"expected an answer to drive, found RESOURCE_EXHAUSTED: .*[Mm]essage larger than max.*"),
        ("terminates", r"expected a plan, found the end of its session at step 6"),
        ("raises", r"expected an answer to drive, found UNKNOWN: .*no checkpoint"),
        ("hangs", r"expected an answer to drive within 1 s, found none"),
    ],
)
def test_failures_of_drivers(
    capsys: pytest.CaptureFixture[str], recorded: tuple[list[str], Path], change: str, expected: str
) -> None:
    driver = FakeDriver(CHANGES[change])
    with served(driver) as address:
        code, answers, errors = plans(capsys, recorded[0], driver=address, timeout_s=1.0)
    assert (code, len(answers), len(errors)) == (1, 2, 1), errors
    assert re.fullmatch(f"pskel.egodriver: driver {address}: {expected}", errors[0]), errors[0]
    assert driver.calls[-1] == "close_session"
    assert driver.of("close_session")[0].session_uuid == driver.of("start_session")[0].session_uuid


def test_failures_of_the_start(capsys: pytest.CaptureFixture[str], recorded: tuple[list[str], Path]) -> None:
    lines, out = recorded
    code, answers, errors = plans(capsys, lines, driver="127.0.0.1:1", timeout_s=0.5)
    assert (code, answers) == (1, [])
    assert errors == ["pskel.egodriver: driver 127.0.0.1:1: expected an answer to get_version within 0.5 s, found none"]
    step = out / "steps/000004"
    with served(FakeDriver()) as address:
        for options, expected in (
            ({"images": "generated"}, f"expected {step}/generated/CAM_FRONT.png, found No such file or directory (generated images need --generator)"),
            ({"images": "boxes"}, f"expected {step}/CAM_FRONT/boxes.png, found No such file or directory (maps are images with --format png, and those of --maps)"),
            ({"cameras": "CAM_TOP"}, "expected cameras among CAM_FRONT, CAM_FRONT_RIGHT, CAM_BACK_RIGHT, CAM_BACK, CAM_BACK_LEFT, CAM_FRONT_LEFT with different IDs, found 'CAM_TOP'"),
        ):  # fmt: skip
            code, answers, errors = plans(capsys, lines, driver=address, **options)
            assert (code, len(answers)) == (1, 1)
            assert errors == [f"pskel.egodriver: {expected}"]
        for sent, expected in (
            ("{", "expected a JSON object from pskel simulate, found '{'"),
            ("[]", "expected a JSON object from pskel simulate, found '[]'"),
            ('{"protocol": "x"}', "expected a hello of protocol pskel-planner, found x"),
            ('{"type": "observation"}', "expected a message of protocol pskel-planner, found KeyError 'step'"),
        ):
            assert plans(capsys, [sent], driver=address) == (1, [], [f"pskel.egodriver: {expected}"])
        see = {**json.loads(lines[1]), "files": []}
        _, _, errors = plans(capsys, [lines[0], json.dumps(see)], driver=address)
        assert errors == ["pskel.egodriver: expected meta.json among the files of a step, found 0 files (--dry writes none)"]


def test_choices_of_cameras() -> None:
    names = ["CAM_FRONT", "CAM_BACK", "CAM_FRONT_LEFT"]
    assert cameras.logical_ids("CAM_BACK,CAM_FRONT=f", names) == {"CAM_BACK": "CAM_BACK", "CAM_FRONT": "f"}
    ids = cameras.logical_ids("alpasim", names)
    assert ids["CAM_FRONT"] == "camera_front_wide_120fov" and len(ids) == 3
    for bad in ("CAM_FRONT=a,CAM_BACK=a", "CAM_FRONT,CAM_FRONT", "", "CAM_FRONT,X"):
        with pytest.raises(DriverError, match="expected"):
            cameras.logical_ids(bad, names)
    with pytest.raises(DriverError, match="expected cameras among left with different IDs, found 'alpasim'"):
        cameras.logical_ids("alpasim", ["left"])


def test_jpeg_images(seen: tuple[FakeDriver, Path]) -> None:
    image = pytest.importorskip("PIL.Image")
    step = seen[1] / "steps/000004"
    jpeg = cameras.Images("color", "jpeg").read(step, "CAM_FRONT")
    png = cameras.Images("color", "png").read(step, "CAM_FRONT")
    assert jpeg.startswith(b"\xff\xd8") and struct.unpack(">II", png[16:24]) == (100, 56)
    a, b = (np.asarray(image.open(io.BytesIO(data)).convert("RGB"), dtype=np.float64) for data in (jpeg, png))
    assert a.shape == b.shape == (56, 100, 3) and np.abs(a - b).mean() < 10.0


def test_ground_truth_and_generated_images(drive: Path, tmp_path: Path) -> None:
    """Ground truth of the reference frames is history; it is written before the driver is asked."""
    driver, out = FakeDriver(), tmp_path / "out"
    with served(driver) as address:
        call(*command(drive, out, address, "--generator=fill", "--images=truth", "--cameras=CAM_FRONT"))
    images = [i.camera_image for i in driver.of("submit_image_observation")]
    assert [i.image_bytes for i in images] == [(out / f"steps/{n:06}/truth/CAM_FRONT.png").read_bytes() for n in (0, 2, 4, 6)]
    spec = driver.of("start_session")[0].rollout_spec.vehicle.available_cameras[0].intrinsics
    assert (spec.resolution_h, spec.resolution_w) == struct.unpack(">II", images[0].image_bytes[16:24])[::-1]
    step = out / "steps/000006"
    assert cameras.Images("auto", "png").read(step, "CAM_BACK") == (step / "generated/CAM_BACK.png").read_bytes()


@contextmanager
def started(change: str) -> Iterator[str]:
    """A driver in a process of its own; yields its address."""
    script = Path(__file__).with_name("egodriver_fakes.py")
    process = subprocess.Popen([sys.executable, str(script), change], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("dies", "expected an answer to drive, found UNAVAILABLE: "),
        ("hangs", "expected an answer to drive within 5 s, found none"),
        ("not finite", "expected finite positions and unit quaternions, found (nan, "),
    ],
)
def test_a_rollout_is_resumed_after_a_failure(drive: Path, tmp_path: Path, change: str, expected: str) -> None:
    with started(change) as address:
        errors = call(*command(drive, tmp_path / "out", address, "--driver-timeout=5"), code=1)
    line = next(line for line in errors.splitlines() if line.startswith("pskel.egodriver: ") and "API" not in line)
    assert line.startswith(f"pskel.egodriver: driver {address}: {expected}"), errors
    assert "error: stopped after 3 steps" in errors
    before = states(tmp_path / "out")
    assert len(before) == 3
    failure = json.loads((tmp_path / "out/metrics.json").read_text())["failure"]
    assert '"$PSKEL_PYTHON" -m pskel.egodriver' in failure
    with served(FakeDriver()) as address:
        call(*command(drive, tmp_path / "out", address, "--resume"))
        call(*command(drive, tmp_path / "whole", address))
    assert states(tmp_path / "out")[:3] == before
    assert (tmp_path / "out/states.jsonl").read_bytes() == (tmp_path / "whole/states.jsonl").read_bytes()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_rollout_and_closes_the_session(drive: Path, tmp_path: Path, number: signal.Signals) -> None:
    driver = FakeDriver(CHANGES["hangs"])
    with served(driver) as address:
        process = subprocess.Popen(command(drive, tmp_path / "out", address), stderr=subprocess.PIPE)
        deadline = time.monotonic() + 60.0
        while driver.calls.count("drive") < 2 and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 128 + number, errors
        assert driver.calls[-1] == "close_session"
        assert driver.of("close_session")[-1].session_uuid == driver.of("start_session")[0].session_uuid
    assert len(states(tmp_path / "out")) == 3


def test_options() -> None:
    own = "expected options of pskel simulate other than --ego, --planner, --planner-timeout, --dry, found"
    for option in ("--ego=replay", "--planner", "--planner-timeout=3", "--dry"):
        with pytest.raises(DriverError) as error:
            launch.run(OPTIONS, ["town:", option])
        assert str(error.value) == f"{own} {option}"
    for arguments, expected in (
        (["town:seed=1", "--steps=3"], "expected --driver HOST:PORT, found none"),
        (["--driver-timeout=0"], "expected a time over 0 s, at most an hour, found '0'"),
        (["--driver-timeout=nan"], "expected a time over 0 s, at most an hour, found 'nan'"),
    ):
        errors = call(sys.executable, "-m", "pskel.egodriver", *arguments, code=2)
        assert errors.splitlines()[-1].endswith(expected), errors
    assert parser().parse_args([]).driver == os.environ.get(launch.DRIVER)
    options = replace(OPTIONS, cameras="CAM_FRONT=a b")
    assert launch.planner(options) == (
        "\"$PSKEL_PYTHON\" -m pskel.egodriver --images auto --encoding png --cameras 'CAM_FRONT=a b'"
    )
