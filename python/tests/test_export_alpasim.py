"""The layout alpasim, read by independent readers and, if it is installed, by AlpaSim's own class."""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from conftest import TOWN
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


@pytest.fixture(scope="module")
def usdz(tmp_path_factory: pytest.TempPathFactory, log: pskel.Log) -> Path:
    folder = tmp_path_factory.mktemp("alpasim")
    # A scene is a whole recording, however long its shards may be.
    report = pskel.export(TOWN, folder / "out", layout="alpasim", skeletons=folder / "skeletons", shard_frames=2)
    assert (report["failures"], report["written"], report["samples"]) == ([], 1, len(log))
    return next((folder / "out").glob("*.usdz"))


@pytest.fixture(scope="module")
def files(usdz: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(usdz) as archive:
        assert archive.testzip() is None
        assert {info.compress_type for info in archive.infolist()} == {zipfile.ZIP_STORED}
        return {name: archive.read(name) for name in archive.namelist()}


def document(files: dict[str, bytes], name: str) -> Any:
    return json.loads(files[name])


def tables(files: dict[str, bytes]) -> dict[str, list[dict[str, Any]]]:
    """Rows of the tables by kind, without their versions."""
    pq: Any = pytest.importorskip("pyarrow.parquet")
    paths = [name for name in files if name.startswith("clipgt/")]
    return {Path(name).stem: pq.read_table(io.BytesIO(files[name])).to_pylist() for name in paths}


def origin(log: pskel.Log) -> Matrix:
    """The origin of local coordinates, as of pskel.serve."""
    return np.floor(log[0].ego[:3, 3])


def xyz(points: list[dict[str, float]]) -> Matrix:
    return np.array([[point[axis] for axis in "xyz"] for point in points])


def test_metadata_is_yaml_and_names_the_scene_as_the_renderer_does(files: dict[str, bytes], log: pskel.Log) -> None:
    yaml: Any = pytest.importorskip("yaml")
    metadata = yaml.safe_load(files["metadata.yaml"])
    assert metadata == document(files, "metadata.yaml")
    assert metadata["scene_id"] == log.name
    assert metadata["time_range"] == {"start": log.times_us[0], "end": log.times_us[-1]}
    assert set(log[0].cameras) < set(metadata["sensors"]["camera_ids"])


def test_poses_and_cameras_equal_the_log(files: dict[str, bytes], log: pskel.Log) -> None:
    document_ = document(files, "rig_trajectories.json")
    world_base = np.eye(4)
    world_base[:3, 3] = origin(log)
    np.testing.assert_array_equal(document_["T_world_base"], world_base)
    (trajectory,) = document_["rig_trajectories"]
    times = trajectory["T_rig_world_timestamps_us"]
    assert times == sorted(set(times)) and (times[0], times[-1]) == (log.times_us[0], log.times_us[-1])
    for scene in log:
        pose = trajectory["T_rig_worlds"][times.index(scene.t_us)]
        np.testing.assert_allclose(world_base @ pose, scene.ego, rtol=0, atol=1e-9)
    first = log.at(log.times_us[0])
    mounts = np.linalg.inv(first.ego) @ np.linalg.inv(first.camera_from_global)
    for name, intrinsics, mount, size in zip(first.cameras, first.intrinsics, mounts, first.sizes, strict=True):
        calibration = document_["camera_calibrations"][name]
        np.testing.assert_allclose(calibration["T_sensor_rig"], mount, rtol=0, atol=1e-9)
        model = calibration["camera_model"]["parameters"]
        np.testing.assert_allclose(model["focal_length"], [intrinsics[0, 0], intrinsics[1, 1]])
        np.testing.assert_allclose(model["principal_point"], intrinsics[:2, 2])
        assert tuple(model["resolution"]) == size[::-1]
        shutters = trajectory["cameras_frame_timestamps_us"][name]
        assert all(start < end and times[0] <= end <= times[-1] for start, end in shutters)


def test_first_images_have_the_calibration_of_their_camera(files: dict[str, bytes], log: pskel.Log) -> None:
    image = pytest.importorskip("PIL.Image")
    rig = json.loads(tables(files)["calibration_estimate"][0]["calibration_estimate"]["rig_json"])["rig"]
    sensors = {sensor["name"].replace(":", "_"): sensor for sensor in rig["sensors"]}
    ends = document(files, "rig_trajectories.json")["rig_trajectories"][0]["cameras_frame_timestamps_us"]
    frames = [Path(name) for name in files if name.startswith("frames/")]
    assert {path.parent.name for path in frames} == set(sensors) and len(frames) == len(log[0].cameras)
    for path in frames:
        assert int(path.stem) == ends[path.parent.name][0][1]
        with image.open(io.BytesIO(files[path.as_posix()])) as picture:
            properties = sensors[path.parent.name]["properties"]
            assert (picture.format, *picture.size) == ("JPEG", int(properties["width"]), int(properties["height"]))


def test_tracks_equal_the_log(files: dict[str, bytes], log: pskel.Log) -> None:
    boxes: dict[str, list[tuple[int, pskel.Actor]]] = {}
    for scene in log:
        for actor in scene.actors:
            boxes.setdefault(actor.track, []).append((scene.t_us, actor))
    sequence = document(files, "sequence_tracks.json")[log.name]
    tracks, sizes = sequence["tracks_data"], sequence["cuboidtracks_data"]["cuboids_dims"]
    several = {track: of for track, of in boxes.items() if len(of) > 1}
    assert set(tracks["tracks_id"]) == set(several) and len(tracks["tracks_id"]) == len(several)
    keys = ["tracks_id", "tracks_timestamps_us", "tracks_poses", "tracks_flags"]
    for track, times, poses, flags, size in zip(*(tracks[key] for key in keys), sizes, strict=True):
        assert times == [t_us for t_us, _ in several[track]] and flags == ["CONTROLLABLE"]
        for (_, actor), (x, y, z, *quaternion) in zip(several[track], poses, strict=True):
            np.testing.assert_allclose(np.array([x, y, z]) + origin(log), actor.global_from_box[:3, 3], rtol=0, atol=1e-9)
            np.testing.assert_allclose(rotation(*quaternion), actor.global_from_box[:3, :3], rtol=0, atol=1e-9)
            assert size == actor.size


def rotation(x: float, y: float, z: float, w: float) -> Matrix:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_lanes_lie_along_the_ego_and_are_linked(files: dict[str, bytes], log: pskel.Log) -> None:
    found = tables(files)
    lanes = {row["key"]["map_id"]: row["lane"] for row in found["lane"]}
    assert len(lanes) == len(found["lane"]) > 20 and not any("-" in lane for lane in lanes)
    centers = {}
    for lane, row in lanes.items():
        left, right = xyz(row["left_rail"]), xyz(row["right_rail"])
        assert left.shape == right.shape and len(row["left_edge_styles"]) == len(left)
        ahead = np.diff((left + right) / 2, axis=0)[0, :2]
        to_left = (left - right)[0, :2]
        width = float(np.linalg.norm(to_left))
        # Lanes of the town are 3.5 m wide; the left border is on the left.
        assert 3 < width < 4 and ahead[0] * to_left[1] - ahead[1] * to_left[0] > 0
        centers[lane] = (left + right) / 2
    # The ego drives along a centerline.
    for scene in log:
        at = scene.ego[:2, 3] - origin(log)[:2]
        assert min(distance(at, center[:, :2]) for center in centers.values()) < 1
    following = {(row["key"]["kind"], row["association"]["subjects"][0]): row["association"]["objects"] for row in found["association"]}
    links = [(lane, after) for lane in lanes for after in following["NEXT_LANE", lane]]
    assert len(links) > 20 and {lane for link in links for lane in link} <= set(lanes)
    assert sorted(links) == sorted((before, lane) for lane in lanes for before in following["PREVIOUS_LANE", lane])
    # A lane begins where the one before it ends.
    assert all(np.linalg.norm(centers[lane][-1] - centers[after][0]) < 0.1 for lane, after in links)


def distance(point: Matrix, line: Matrix) -> float:
    """Distance of a point from a polyline, meters."""
    start, step = line[:-1], np.diff(line, axis=0)
    along = np.clip(np.sum((point - start) * step, axis=1) / np.sum(step * step, axis=1), 0, 1)
    return float(np.linalg.norm(start + along[:, None] * step - point, axis=1).min())


def test_stop_lines_belong_to_lanes_that_cross_them(files: dict[str, bytes]) -> None:
    found = tables(files)
    centers = {row["key"]["map_id"]: (xyz(row["lane"]["left_rail"]) + xyz(row["lane"]["right_rail"])) / 2 for row in found["lane"]}
    assert found["traffic_sign"] == [] and len(found["clip"]) == 1
    keys = [row["key"]["map_id"] for kind in ["wait_line", "road_boundary"] for row in found[kind]]
    assert len(keys) == len(set(keys)) > 2
    owned = 0
    for row in found["wait_line"]:
        _, lane = row["key"]["map_id"].split("-")
        if lane:
            middle = xyz(row["wait_line"]["location"]).mean(axis=0)[:2]
            assert distance(middle, centers[lane][:, :2]) < 3
            owned += 1
    assert owned > 0


def test_artifact_of_alpasim_loads_the_scene(usdz: Path, log: pskel.Log, files: dict[str, bytes]) -> None:
    artifact: Any = pytest.importorskip("alpasim_utils.artifact")
    scene = artifact.Artifact(str(usdz), _smooth_trajectories=False)
    assert scene.scene_id == log.name
    trajectory = scene.rig.trajectory
    assert set(log[0].cameras) < {camera.logical_name for camera in scene.rig.camera_ids}
    assert scene.rig.first_camera_frame_end_us(log[0].cameras) >= log.times_us[0]
    times = list(trajectory.timestamps_us)
    for frame in log:
        # AlpaSim has single precision.
        position = (frame.ego[:3, 3] - origin(log)).astype(np.float32)
        np.testing.assert_array_equal(trajectory.get_pose(times.index(frame.t_us)).vec3, position)
    assert len(scene.traffic_objects) == len(document(files, "sequence_tracks.json")[log.name]["tracks_data"]["tracks_id"])
    if artifact.VectorMap is not None:
        counts = {kind.name: len(items) for kind, items in scene.map.elements.items()}
        rows = tables(files)
        expected = {"ROAD_LANE": "lane", "ROAD_EDGE": "road_boundary", "WAIT_LINE": "wait_line"}
        assert {kind: counts[kind] for kind in expected} == {kind: len(rows[table]) for kind, table in expected.items()}
