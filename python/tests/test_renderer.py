"""Maps in Python equal the maps of the command."""

import os
from pathlib import Path

import numpy as np
import pskel
import pytest
from conftest import TOWN, Run

MAPS = ["color", "depth", "class", "instance", "boxes", "map", "point"]


@pytest.mark.parametrize("rasterizer", ["auto", "graphics", "cpu"])
def test_maps_equal_those_of_the_command(
    log: pskel.Log, skeleton: pskel.Skeleton, tmp_path: Path, run: Run, rasterizer: str
) -> None:
    out = tmp_path / "maps"
    options = ["--maps", ",".join([*MAPS, "tensor"]), "--out-size", "56x100", "--ego-offset", "forward_m=1,left_m=2,yaw_deg=5"]
    command = ["render", TOWN, "--skeleton", str(skeleton.path), "--out", str(out), "--frames", "1..3"]
    run("-m", "pskel", *command, "--format", "npz", "--rasterizer", rasterizer, *options)
    with pskel.Renderer(skeleton, out_size=(56, 100), maps=[*MAPS, "tensor"], rasterizer=rasterizer) as renderer:
        for frame in (1, 2):
            maps = renderer.render(log[frame].move_ego(forward_m=1.0, left_m=2.0, yaw_deg=5.0))
            with np.load(out / f"{frame:06}" / "maps.npz") as expected:
                assert set(expected) == set(maps)
                for name, found in maps.items():
                    assert isinstance(found, np.ndarray)
                    if name == "depth":
                        found = np.where(np.isinf(found), np.float32(-300.0), found)
                    assert found.dtype == expected[name].dtype, name
                    np.testing.assert_array_equal(found, expected[name], err_msg=name)
            assert np.isfinite(maps["depth"]).mean() > 0.1
            assert maps["color"].flags.writeable and maps["color"].flags.c_contiguous


def test_a_series_of_frames_equals_single_frames(log: pskel.Log, renderer: pskel.Renderer) -> None:
    series = list(renderer.render_all(log[i] for i in range(len(log))))
    assert len(series) == len(log)
    for frame, maps in enumerate(series):
        for name, found in renderer.render(log[frame]).items():
            np.testing.assert_array_equal(found, maps[name])  # type: ignore[literal-required]


def test_a_series_notices_other_calls_and_bad_items(log: pskel.Log, renderer: pskel.Renderer) -> None:
    frames = renderer.render_all([log[0], log[1], log[2]])
    next(frames)
    renderer.render(log[0])
    with pytest.raises(RuntimeError, match="no other call of the Renderer while its frames are iterated"):
        next(frames)
    with pytest.raises(TypeError):
        list(renderer.render_all([log[0], "scene"]))  # type: ignore[list-item]

    def broken() -> "list[pskel.Scene]":
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        list(renderer.render_all(scene for scene in broken()))
    assert renderer.render(log[0])["color"].any()


def test_actors_can_be_removed(log: pskel.Log, renderer: pskel.Renderer) -> None:
    scene = log[1]
    shown = renderer.render(scene)
    number = int(np.bincount(shown["instance"].ravel())[1:].argmax()) + 1
    track = scene.actors[number - 1].track
    without = renderer.render(scene.without(track))
    behind = shown["instance"] == number
    assert behind.any()
    assert (without["depth"][behind] >= shown["depth"][behind]).all()
    np.testing.assert_array_equal(without["depth"][~behind], shown["depth"][~behind])
    with pytest.raises(KeyError, match="expected the track of an actor"):
        scene.without("nobody")


def test_scenes_describe_their_cameras(log: pskel.Log) -> None:
    scene = log[0]
    assert scene.name == "000000" and scene.t_us == log.times_us[0] and len(scene.cameras) == 6
    assert scene.intrinsics.shape == (6, 3, 3) and scene.camera_from_global.shape == (6, 4, 4)
    assert scene.sizes == [(113, 200)] * 6
    scene = log.at((log.times_us[0] + log.times_us[1]) // 2)  # all cameras at one time
    moved = scene.move_ego(forward_m=3.0, left_m=-1.0, yaw_deg=90.0)
    np.testing.assert_allclose(np.linalg.inv(scene.ego) @ moved.ego @ [0, 0, 0, 1], [3, -1, 0, 1], atol=1e-9)
    rig = scene.camera_from_global @ scene.ego
    np.testing.assert_allclose(moved.camera_from_global @ moved.ego, rig, atol=1e-9)


def test_logs_are_sequences(log: pskel.Log) -> None:
    assert len(list(iter(log))) == len(log) == 4  # type: ignore[call-overload]
    assert log[-1].t_us == log[3].t_us
    middle = log.at((log.times_us[0] + log.times_us[1]) // 2)
    assert log[0].t_us < middle.t_us < log[1].t_us
    for index in (4, -5):
        with pytest.raises(IndexError, match=f"expected a frame below 4, found {index}"):
            log[index]
    with pytest.raises(ValueError, match="expected a time of the log"):
        log.at(0)


def test_images_of_a_town_follow_the_scene(log: pskel.Log) -> None:
    images = log.images(log[1], (56, 100))
    assert images.shape == (6, 56, 100, 3) and images.dtype == np.uint8
    moved = log.images(log[1].move_ego(left_m=2.0), (56, 100))
    assert (images != moved).any()


def test_own_points_need_no_reader(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    far = np.array([500_000.0, 4_000_000.0, 30.0])  # a city in UTM coordinates
    wall = np.column_stack([np.full(500, 20.0), rng.uniform(-5, 5, 500), rng.uniform(-2, 2, 500)])
    background = np.hstack([wall + far, rng.integers(0, 256, (500, 3))])
    box = np.hstack([rng.uniform(-1, 1, (100, 3)), np.tile([255, 0, 0], (100, 1))])
    skeleton = pskel.Skeleton.from_points(
        tmp_path / "skeleton", background, {"car-1": ("vehicle.car", (4.0, 2.0, 1.5), box)}
    )
    assert skeleton.background_points == 500 and skeleton.tracks == ["car-1"]
    # Camera axes (x right, y down, z forward) from ego axes (x forward, y left, z up).
    ego_from_camera = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    intrinsics = [[100, 0, 50], [0, 100, 30], [0, 0, 1]]
    camera = pskel.Camera("front", intrinsics, (60, 100), ego_from_camera)
    ego = np.eye(4)
    ego[:3, 3] = far
    car = ego.copy()
    car[0, 3] += 10.0
    actor = pskel.Actor("car-1", "vehicle.car", (4.0, 2.0, 1.5), car)
    scene = pskel.Scene(ego, [camera], [actor])
    options = {"maps": ["color", "depth", "instance", "class"], "rasterizer": "cpu", "min_actor_points": 0}
    maps = pskel.Renderer(skeleton, **options).render(scene)  # type: ignore[arg-type]
    depth = maps["depth"][0]
    assert set(np.unique(maps["class"])) == {0, 1}
    assert ((depth[maps["instance"][0] == 1] > 8.9) & (depth[maps["instance"][0] == 1] < 11.1)).all()
    on_wall = np.isfinite(depth) & (maps["instance"][0] == 0)
    assert on_wall.sum() > 100
    np.testing.assert_allclose(depth[on_wall], 20.0, atol=1e-4)


def test_splat_projects_points_exactly() -> None:
    points = np.array([[0.0, 0.0, 5.0, 10, 20, 30, 1], [1.0, 0.0, 50.0, 255, 0, 0, 2]])
    intrinsics = np.array([[[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]])
    maps = pskel.splat(points, intrinsics, np.eye(4)[None], (80, 100), schedule="10:1,60:0", rasterizer="cpu")
    expected = np.zeros((80, 100), np.uint8)
    expected[39:42, 49:52] = 1
    expected[40, 52] = 2
    np.testing.assert_array_equal(maps["class"][0], expected)
    assert maps["color"][0, 40, 50].tolist() == [10, 20, 30]
    assert maps["depth"][0, 40, 52] == 50.0 and np.isinf(maps["depth"][0, 0, 0])
    assert maps["point"][0, 40, 50] == 1 and maps["point"][0, 40, 52] == 2
    # Any layout and number type gives the same.
    other = np.asfortranarray(points.astype(np.float32))
    other.flags.writeable = False
    again = pskel.splat(other, intrinsics.tolist(), [np.eye(4)], (80, 100), schedule="10:1,60:0", rasterizer="cpu")
    np.testing.assert_array_equal(again["color"], maps["color"])
    strided = np.repeat(points, 2, axis=0)[::2]
    again = pskel.splat(strided, intrinsics, np.eye(4)[None], (80, 100), schedule="10:1,60:0", rasterizer="cpu")
    np.testing.assert_array_equal(again["point"], maps["point"])


def test_memory_stays_flat(log: pskel.Log, skeleton: pskel.Skeleton) -> None:
    scene, renderer = log[0], pskel.Renderer(skeleton, size=(56, 100), maps=[*MAPS, "tensor"])

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1])

    for _ in range(100):
        renderer.render(scene)
    before = resident()
    for _ in range(int(os.environ.get("PSKEL_MEMORY_FRAMES", "400"))):
        renderer.render(scene)
    assert resident() < 1.05 * before


def test_logs_have_scenes_by_index_slice_and_iteration(log: pskel.Log) -> None:
    names = [scene.name for scene in log]
    assert names == [log[i].name for i in range(len(log))] and len(set(names)) == 4
    assert [scene.name for scene in log[1:3]] == names[1:3] and [scene.name for scene in log[::-2]] == names[::-2]
    assert log[9:] == [] and [scene.name for scene in reversed(log)] == names[::-1]
    for index in (4, -5, 2**70):
        with pytest.raises(IndexError):
            log[index]
    assert repr(log[0]).startswith("Scene(")


def test_a_device_is_named_by_index_too(skeleton: pskel.Skeleton) -> None:
    with pskel.Renderer(skeleton, maps=["depth"], device=0) as renderer:
        assert renderer.device and repr(renderer).startswith("Renderer(")
    with pytest.raises(pskel.RenderError, match="99"):
        pskel.Renderer(skeleton, maps=["depth"], device=99)


def test_a_scene_without_an_hd_map_has_no_map(skeleton: pskel.Skeleton) -> None:
    eye = np.eye(4)
    scene = pskel.Scene(eye, [pskel.Camera("front", [[100, 0, 50], [0, 100, 40], [0, 0, 1]], (80, 100), eye)])
    with pskel.Renderer(skeleton, maps=["map"], rasterizer="cpu") as renderer:
        with pytest.raises(ValueError, match="expected an HD map"):
            renderer.render(scene)
