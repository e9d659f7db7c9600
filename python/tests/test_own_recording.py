"""The script of docs/src/guide/own_recording.md writes a town as a log of py123d, which is read back as the same drive.

py123d needs an environment of its own: its Python is named by PSKEL_PY123D_PYTHON.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pskel
import pytest

PYTHON = os.environ.get("PSKEL_PY123D_PYTHON")
PAGE = Path(__file__).parents[2] / "docs/src/guide/own_recording.md"
TOWN = "seed=7,frames=6,size=90x160"
SIZE = (90, 160)
#: Cameras of the town and of py123d, in the order around the vehicle.
CAMERAS = {
    "CAM_FRONT": "PCAM_F0",
    "CAM_FRONT_RIGHT": "PCAM_R0",
    "CAM_BACK_RIGHT": "PCAM_R1",
    "CAM_BACK": "PCAM_B0",
    "CAM_BACK_LEFT": "PCAM_L1",
    "CAM_FRONT_LEFT": "PCAM_L0",
}

pytestmark = pytest.mark.skipif(PYTHON is None, reason="needs PSKEL_PY123D_PYTHON")


def command(*args: str | Path) -> str:
    """Runs the command pskel, and returns its output."""
    return run(sys.executable, "-m", "pskel", *args)


def run(*args: str | Path) -> str:
    done = subprocess.run([*map(str, args)], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the town's files in `town`, and the log that the script makes of them."""
    folder = tmp_path_factory.mktemp("own")
    command("town", TOWN, "--out", folder / "town")
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 4
    (folder / "own_recording.py").write_text("\n".join(blocks))
    assert PYTHON is not None
    run(PYTHON, folder / "own_recording.py", folder / "town", folder)
    return folder


@pytest.fixture(scope="module")
def name(folder: Path) -> str:
    """The name of the log."""
    return f"123d:{folder}"


@pytest.fixture(scope="module")
def recorded(name: str) -> pskel.Log:
    return pskel.Log(name)


@pytest.fixture(scope="module")
def town() -> pskel.Log:
    return pskel.Log(f"town:{TOWN}")


def tables(dataset: Path) -> dict[str, list[dict[str, Any]]]:
    return {file.stem: json.loads(file.read_text()) for file in (dataset / "v1.0-town").glob("*.json")}


def sweeps(dataset: Path) -> dict[int, Path]:
    """Files of sweeps by time."""
    rows = sorted(tables(dataset)["sample_data"], key=lambda row: int(row["timestamp"]))
    return {row["timestamp"]: dataset / row["filename"] for row in rows if "LIDAR" in row["filename"]}


@pytest.fixture(scope="module")
def stored(folder: Path) -> dict[int, npt.NDArray[np.float32]]:
    """Points of each sweep of the log by time: x, y, z, intensity, ring."""
    pa: Any = pytest.importorskip("pyarrow")
    table = pa.ipc.open_file(folder / "logs/own_train/drive-0001/lidar.lidar_top.arrow").read_all()
    times, blobs = (table[f"lidar.lidar_top.{column}"].to_pylist() for column in ("timestamp_us", "data"))
    points = [pa.ipc.open_stream(blob).read_all() for blob in blobs]
    columns = [[sweep[key].to_numpy() for key in ("x", "y", "z", "intensity", "channel")] for sweep in points]
    return {t: np.stack(values, axis=1).astype(np.float32) for t, values in zip(times, columns, strict=True)}


@pytest.fixture(scope="module")
def in_ego_frame(folder: Path, stored: dict[int, npt.NDArray[np.float32]]) -> Path:
    """The town's files with the points of the log: its LiDAR is at the origin of the ego."""
    copy = folder / "in_ego_frame"
    shutil.copytree(folder / "town", copy, ignore=shutil.ignore_patterns("*.png"))
    for t, file in sweeps(copy).items():
        stored[t].tofile(file)
    path = copy / "v1.0-town/calibrated_sensor.json"
    sensors = json.loads(path.read_text())
    for sensor in sensors:
        if not sensor["camera_intrinsic"]:
            sensor["rotation"], sensor["translation"] = [1, 0, 0, 0], [0, 0, 0]
    path.write_text(json.dumps(sensors))
    return copy


def test_frames_and_cameras_are_those_of_the_town(recorded: pskel.Log, town: pskel.Log) -> None:
    assert (recorded.name, recorded.location) == ("drive-0001", "town")
    assert recorded.times_us == town.times_us and len(recorded) == 6
    assert recorded.gaps == []
    for found, scene in zip(recorded, town, strict=True):
        assert scene.cameras == list(CAMERAS) and found.cameras == list(CAMERAS.values())
        assert (found.t_us, found.sizes) == (scene.t_us, scene.sizes)
        np.testing.assert_array_equal(found.intrinsics, scene.intrinsics)
        np.testing.assert_allclose(found.ego, scene.ego, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.camera_from_global, scene.camera_from_global, rtol=0, atol=1e-9)


def test_boxes_are_those_of_the_town(recorded: pskel.Log, town: pskel.Log) -> None:
    for found, scene in zip(recorded, town, strict=True):
        assert [actor.track for actor in found.actors] == [actor.track for actor in scene.actors]
        assert [actor.category for actor in found.actors] == [actor.category for actor in scene.actors]
        for actor, true in zip(found.actors, scene.actors, strict=True):
            np.testing.assert_allclose(actor.size, true.size, rtol=0, atol=1e-9)
            np.testing.assert_allclose(actor.global_from_box, true.global_from_box, rtol=0, atol=1e-9)
    assert len({actor.category for scene in town for actor in scene.actors}) > 2


def test_images_are_those_of_the_files(folder: Path, recorded: pskel.Log) -> None:
    files = pskel.Log(f"nuscenes:{folder / 'town'}")
    for found, scene in zip(recorded, files, strict=True):
        images = files.images(scene, SIZE)
        np.testing.assert_array_equal(recorded.images(found, SIZE), images)
        assert images.std(axis=(1, 2, 3)).min() > 10


def test_sweeps_are_written_in_the_ego_frame(folder: Path, stored: dict[int, npt.NDArray[np.float32]]) -> None:
    """The LiDAR of a town looks along its y axis, as in nuScenes: x of the sensor is to the right of the ego."""
    (sensor,) = (row for row in tables(folder / "town")["calibrated_sensor"] if not row["camera_intrinsic"])
    mount = np.array(sensor["translation"])
    assert list(sweeps(folder / "town")) == list(stored) and len(stored) == 11
    for t, file in sweeps(folder / "town").items():
        points = np.fromfile(file, np.float32).reshape(-1, 5)
        x, y, z = points[:, :3].astype(np.float64).T
        expected = np.stack([y, -x, z], axis=1) + mount
        np.testing.assert_allclose(stored[t][:, :3], expected, rtol=0, atol=1e-5)
        np.testing.assert_array_equal(stored[t][:, 3:], points[:, 3:])


def test_skeletons_have_the_same_points(
    recorded: pskel.Log, name: str, in_ego_frame: Path, tmp_path: Path
) -> None:
    """Rounding the points to `float32` in another frame moves 88 of 274 193, and 2 pixels in 10 000."""
    files = pskel.Log(f"nuscenes:{in_ego_frame}")
    for between in (False, True):
        made = pskel.build(recorded, tmp_path / f"made-{between}", voxel=0.0, sweeps=between)
        true = pskel.build(files, tmp_path / f"true-{between}", voxel=0.0, sweeps=between)
        assert made.tracks == true.tracks and len(made.tracks) > 10
        assert abs(made.background_points - true.background_points) <= 3
        with pskel.Renderer(made) as found, pskel.Renderer(true) as expected:
            for one, other in zip(found.render_all(recorded), expected.render_all(files), strict=True):
                assert np.isfinite(other["depth"]).mean() > 0.5
                for key in ("depth", "color", "instance"):
                    assert np.mean(np.asarray(one[key] == other[key])) > 0.9999, key


def test_the_map_is_that_of_the_town(recorded: pskel.Log, town: pskel.Log, tmp_path: Path) -> None:
    skeletons = [pskel.build(log, tmp_path / log.name) for log in (recorded, town)]
    first, second = (pskel.Renderer(skeleton, maps=["map"]) for skeleton in skeletons)
    with first, second:
        for found, scene in zip(recorded, town, strict=True):
            one, other = first.render(found)["map"], second.render(scene)["map"]
            assert other.any(axis=-1).mean() > 0.01
            # Outlines of lanes begin at other corners.
            assert np.mean((one == other).all(axis=-1)) > 0.999


def test_info_counts_what_the_files_have(folder: Path, name: str) -> None:
    found = json.loads(command("info", "--json", name))
    files = json.loads(command("info", "--json", f"nuscenes:{folder / 'town'}"))
    same = ["boxes", "tracks", "categories", "frames", "frame_rate_hz", "seconds", "sweeps", "points", "t_us"]
    assert {key: found[key] for key in same} == {key: files[key] for key in same}
    assert found["cameras"] == [{**camera, "name": CAMERAS[camera["name"]]} for camera in files["cameras"]]
    assert found["ego"]["path_m"] == pytest.approx(files["ego"]["path_m"], abs=1e-9)
    assert found["map"] == {**files["map"], "lane_connectors": 0, "stop_lines": 0}
    assert files["map"]["crossings"] > 0 and found["damaged"] == [] and found["gaps"] == []


def test_commands_of_the_page_run(name: str, tmp_path: Path) -> None:
    skeleton, small = tmp_path / "skeleton", ["--out-size", "45x80"]
    assert "built drive-0001 from 6 frames" in command("build", name, "--out", skeleton)
    command("render", name, "--skeleton", skeleton, "--out", tmp_path / "maps", "--frames", "0..3", *small)
    assert sorted(path.parent.name for path in (tmp_path / "maps").glob("*/sheet.png")) == ["000000", "000001", "000002"]
    shards = tmp_path / "shards"
    layout: list[str | Path] = ["--layout", "webdataset", "--images", "--skeletons", tmp_path / "skeletons", *small]
    command("export", name, *layout, "--out", shards)
    with tarfile.open(next(shards.glob("*.tar"))) as tar:
        assert sum(member.endswith(".color.pcam_f0.png") for member in tar.getnames()) == 6
    drive = ["--ego", "lane_change", "--actors", "idm", "--steps", "10"]
    command("simulate", name, "--skeleton", skeleton, "--out", tmp_path / "rollout", *drive, *small)
    metrics = json.loads((tmp_path / "rollout/metrics.json").read_text())
    assert metrics["steps"] == 10 and metrics["off_road"]["share"] == 0 and metrics["progress_m"] > 3
    images = ["--generator", "fill", "--window", "2", "--every", "1"]
    done = command("generate", name, "--skeleton", skeleton, "--out", tmp_path / "images", *images)
    assert "5 frames generated" in done
