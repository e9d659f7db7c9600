"""The layout `mcap` of exports, read by the packages `mcap` and `mcap-protobuf-support`."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from conftest import TOWN
from mcap_files import matrix, read, vector

MAPS = ["color", "depth", "boxes"]
def test_mcap_opens_in_the_reader(tmp_path: Path, renderer: pskel.Renderer, log: pskel.Log) -> None:
    pytest.importorskip("mcap")
    image: Any = pytest.importorskip("PIL.Image")
    scenes = [log[index] for index in range(len(log))]
    options: dict[str, Any] = {"images": True, "maps": MAPS, "out_size": (56, 100)}
    report = pskel.export(TOWN, tmp_path / "out", layout="mcap", skeletons=tmp_path / "skeletons", **options)
    assert report["failures"] == [] and (report["written"], report["samples"]) == (1, len(scenes))
    topics, metadata = read(next((tmp_path / "out").glob("*.mcap")))
    cameras = scenes[0].cameras
    kinds = [*MAPS, "image", "calibration"]
    of_cameras = {f"/camera/{camera}/{kind}" for camera in cameras for kind in kinds}
    assert set(topics) == of_cameras | {"/tf", "/actors", "/log"}
    times = [1000 * scene.t_us for scene in scenes]
    for topic, messages in topics.items():
        assert [time for time, _ in messages] == (times[:1] if topic == "/log" else times), topic
    global_from_map = np.eye(4)
    global_from_map[:3, 3] = json.loads(metadata["log"]["map_origin"])
    np.testing.assert_allclose(global_from_map[:3, 3], scenes[0].ego[:3, 3])
    for index, scene in enumerate(scenes):
        maps = renderer.render(scene)
        transforms = topics["/tf"][index][1].transforms
        poses = {t.child_frame_id: (t.parent_frame_id, matrix(t.rotation, t.translation)) for t in transforms}
        assert set(poses) == {"ego"} | {f"camera/{camera}" for camera in cameras}
        parent, map_from_ego = poses["ego"]
        assert parent == "map"
        np.testing.assert_allclose((global_from_map @ map_from_ego)[:3], scene.ego[:3], atol=1e-9)
        for number, camera in enumerate(cameras):
            parent, ego_from_camera = poses[f"camera/{camera}"]
            assert parent == "ego"
            camera_from_global = np.linalg.inv(global_from_map @ map_from_ego @ ego_from_camera)
            np.testing.assert_allclose(camera_from_global[:3], scene.camera_from_global[number][:3], atol=1e-6)
            of_kind = {kind: topics[f"/camera/{camera}/{kind}"][index][1] for kind in kinds}
            assert {message.frame_id for message in of_kind.values()} == {f"camera/{camera}"}
            scale = np.diag([100 / scene.sizes[number][1], 56 / scene.sizes[number][0], 1])
            np.testing.assert_allclose(np.reshape(of_kind["calibration"].K, (3, 3)), scale @ scene.intrinsics[number])
            assert (of_kind["calibration"].height, of_kind["calibration"].width) == (56, 100)
            for kind in ["color", "boxes"]:
                assert of_kind[kind].format == "png"
                pixels = np.asarray(image.open(io.BytesIO(of_kind[kind].data)))
                np.testing.assert_array_equal(pixels, maps[kind][number])  # type: ignore[literal-required]
            photo = image.open(io.BytesIO(of_kind["image"].data))
            assert (of_kind["image"].format, photo.format, photo.size) == ("jpeg", "JPEG", (100, 56))
        update = topics["/actors"][index][1]
        assert len(update.deletions) == 1
        assert [entity.id for entity in update.entities] == [actor.track for actor in scene.actors]
        for entity, actor in zip(update.entities, scene.actors, strict=True):
            cube = entity.cubes[0]
            box = global_from_map @ matrix(cube.pose.orientation, cube.pose.position)
            np.testing.assert_allclose(box[:3], actor.global_from_box[:3], atol=1e-6)
            np.testing.assert_allclose(vector(cube.size), actor.size)
            assert (entity.frame_id, entity.metadata[0].value) == ("map", actor.category)
