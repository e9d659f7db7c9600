"""AlpaSim's renderer service: images equal the command's, moved tracks move, each failure has its status."""

import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from numpy.typing import NDArray

grpc = pytest.importorskip("grpc")
pytest.importorskip("PIL")
from pskel.alpasim import API_VERSION, common_pb2, poses, sensorsim_pb2, sensorsim_pb2_grpc  # noqa: E402
from pskel.serve import cameras  # noqa: E402
from pskel.serve.errors import RequestError  # noqa: E402
from sensorsim_client import Request, batch, decoded, exact_town, requests, run, server, stub  # noqa: E402

EMPTY = common_pb2.Empty()


class Towns:
    """Two scenes on a server that shows color maps as they are."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.names, self.skeletons = zip(*(exact_town(folder, seed) for seed in (7, 8)), strict=True)
        self.logs = [pskel.Log(name) for name in self.names]
        self.arguments = [*map(str, self.skeletons), *(f"--log={name}" for name in self.names), "--images=color"]

    def requests(self, client: Any, scene: int = 0, frame: int = 2) -> dict[str, Request]:
        log = self.logs[scene]
        available = client.get_available_cameras(sensorsim_pb2.AvailableCamerasRequest(scene_id=log.name))
        return requests(log, log[frame], available)


@pytest.fixture(scope="module")
def towns(tmp_path_factory: pytest.TempPathFactory) -> Towns:
    return Towns(tmp_path_factory.mktemp("towns"))


@pytest.fixture(scope="module")
def client(towns: Towns) -> Iterator[sensorsim_pb2_grpc.SensorsimServiceStub]:
    with server(*towns.arguments) as (_, address):
        yield stub(address)


def test_all_cameras_of_two_scenes_equal_the_command_with_four_requests_in_flight(towns: Towns, client: Any) -> None:
    work = []
    for number, (name, skeleton, log) in enumerate(zip(towns.names, towns.skeletons, towns.logs, strict=True)):
        out = towns.folder / f"render{number}"
        run("render", name, f"--skeleton={skeleton}", "--maps=color", f"--out={out}")
        work += [(out / scene.name, towns.requests(client, number, frame)) for frame, scene in enumerate(log)]
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda item: client.batch_render_rgb(batch(item[1])), work))
    count = 0
    for (folder, asked), answer in zip(work, answers, strict=True):
        assert [item.camera_name for item in answer.items] == list(asked)
        for item in answer.items:
            assert item.success and not item.error_message
            expected = decoded((folder / item.camera_name / "color.png").read_bytes())
            assert expected.any()
            np.testing.assert_array_equal(decoded(item.result.image_bytes), expected, f"{folder} {item.camera_name}")
            count += 1
    assert count == 2 * 6 * 6


def test_descriptions(towns: Towns, client: Any) -> None:
    log = towns.logs[0]
    version = client.get_version(EMPTY)
    api = version.grpc_api_version
    assert version.version_id == f"pskel {pskel.__version__}" and (api.major, api.minor, api.patch) == API_VERSION
    assert list(client.get_available_scenes(EMPTY).scene_ids) == sorted(log.name for log in towns.logs)
    available = client.get_available_cameras(sensorsim_pb2.AvailableCamerasRequest(scene_id=log.name)).available_cameras
    scene = log.at(log.times_us[0])  # all cameras at the time of the ego
    assert [camera.logical_id for camera in available] == scene.cameras
    for camera, k, size, view in zip(available, scene.intrinsics, scene.sizes, scene.camera_from_global, strict=True):
        spec = camera.intrinsics
        assert (spec.resolution_h, spec.resolution_w) == size and spec.logical_id == camera.logical_id
        np.testing.assert_array_equal(cameras.matrix(spec.opencv_pinhole_param, np.ones(2)), k)
        np.testing.assert_allclose(poses.matrix(camera.rig_to_camera), np.linalg.inv(view @ scene.ego), atol=1e-6)
    assert not client.get_available_ego_masks(EMPTY).ego_mask_metadata
    asked = sensorsim_pb2.AvailableTrajectoriesRequest(scene_id=log.name)
    (trajectory,) = client.get_available_trajectories(asked).available_trajectories
    origin = np.floor(scene.ego[:3, 3])
    assert [at.timestamp_us for at in trajectory.trajectory.poses] == log.times_us
    for at, frame in zip(trajectory.trajectory.poses, log, strict=True):
        np.testing.assert_array_equal(poses.matrix(at.pose, origin), frame.ego)
    client.render_rgb(next(iter(towns.requests(client).values())))
    loaded = client.get_loaded_scenes(EMPTY)
    assert log.name in [entry.scene_id for entry in loaded.scenes] and loaded.loaded_instance_capacity == 4


def test_moved_and_missing_tracks(towns: Towns, client: Any) -> None:
    """The oracle is the renderer with the same scene."""
    log, scene = towns.logs[0], towns.logs[0][2]
    renderer = pskel.Renderer(pskel.Skeleton(towns.skeletons[0]), maps=["color", "instance"], log=log.name)
    instances = renderer.render(scene)["instance"]
    number, pixels = max(((n, (instances == n).sum()) for n in range(1, len(scene.actors) + 1)), key=lambda item: item[1])
    assert pixels > 50
    seen = scene.actors[number - 1]
    moved = np.array(seen.global_from_box)
    moved[:3, 3] += (0.5, -0.75, 0.25)
    asked = towns.requests(client)
    for kept in (True, False):
        actors = [actor for actor in scene.actors if actor.track != seen.track]
        if kept:
            actors.append(pskel.Actor(seen.track, seen.category, seen.size, moved))
        mounts = np.linalg.inv(scene.ego) @ np.linalg.inv(scene.camera_from_global)
        rig = [
            pskel.Camera(*camera)
            for camera in zip(scene.cameras, scene.intrinsics, scene.sizes, mounts, strict=True)
        ]
        expected = renderer.render(pskel.Scene(scene.ego, rig, actors))["color"]
        for request in asked.values():
            objects = [item for item in request.dynamic_objects if item.track_id != seen.track]
            if kept:
                pose = poses.pose(moved, np.floor(log[0].ego[:3, 3]))
                pair = {"start_pose": pose, "end_pose": pose}
                objects.append(sensorsim_pb2.DynamicObject(track_id=seen.track, pose_pair=pair))
            del request.dynamic_objects[:]
            request.dynamic_objects.extend(objects)
        answer = client.batch_render_rgb(batch(asked))
        found = np.stack([decoded(item.result.image_bytes) for item in answer.items])
        np.testing.assert_array_equal(found, expected)
        assert (found != renderer.render(scene)["color"]).any()


def test_one_camera_several_at_once_and_its_own_parameters(towns: Towns, client: Any) -> None:
    asked = towns.requests(client)
    whole = {item.camera_name: item.result.image_bytes for item in client.batch_render_rgb(batch(asked)).items}
    name, request = next(iter(asked.items()))
    assert client.render_rgb(request).image_bytes == whole[name]
    aggregated = client.render_aggregated(sensorsim_pb2.AggregatedRenderRequest(rgb_requests=list(asked.values())))
    assert [answer.image_bytes for answer in aggregated.rgb_returns] == list(whole.values())
    # A camera of the log needs no parameters; without the pose of the ego, it follows from the camera's mount.
    short = Request.FromString(request.SerializeToString())
    short.camera_intrinsics.CopyFrom(sensorsim_pb2.CameraSpec(logical_id=name))
    short.ClearField("resolution_h")
    short.ClearField("resolution_w")
    short.ClearField("ego_pose")
    assert client.render_rgb(short).image_bytes == whole[name]
    # Half the size has half the intrinsics, regardless of the specification.
    half = Request.FromString(request.SerializeToString())
    half.resolution_h, half.resolution_w = 56, 100
    assert decoded(client.render_rgb(half).image_bytes).shape == (56, 100, 3)
    jpeg = Request.FromString(request.SerializeToString())
    jpeg.image_format = sensorsim_pb2.JPEG
    data = client.render_rgb(jpeg).image_bytes
    difference = np.abs(decoded(data).astype(int) - decoded(whole[name]).astype(int))
    assert data.startswith(b"\xff\xd8") and difference.mean() < 12.0
    # The pose of a rolling shutter is the mean.
    shutter = Request.FromString(request.SerializeToString())
    shutter.sensor_pose.start_pose.vec.x -= 0.5
    shutter.sensor_pose.end_pose.vec.x += 0.5
    assert client.render_rgb(shutter).image_bytes == whole[name]


def wrong(change: Callable[[Request], object]) -> Callable[[Request], object]:
    return change


WRONG = {
    "scene": (wrong(lambda r: setattr(r, "scene_id", "nowhere")), "NOT_FOUND", "expected a scene among town-7-6f-overcast, town-8-6f-overcast, found 'nowhere'"),
    "camera": (wrong(lambda r: r.camera_intrinsics.CopyFrom(sensorsim_pb2.CameraSpec(logical_id="CAM_TOP"))), "NOT_FOUND", "expected the parameters of a camera, or one of CAM_FRONT, "),
    "track": (wrong(lambda r: r.dynamic_objects.add(track_id="x", pose_pair=r.sensor_pose)), "NOT_FOUND", "expected a track of the scene (it has "),
    "track twice": (wrong(lambda r: r.dynamic_objects.append(r.dynamic_objects[0])), "INVALID_ARGUMENT", "expected each track once, found two of "),
    "mask": (wrong(lambda r: setattr(r, "insert_ego_mask", True)), "NOT_FOUND", "expected no ego mask"),
    "nan": (wrong(lambda r: setattr(r.sensor_pose.start_pose.vec, "x", float("nan"))), "INVALID_ARGUMENT", "sensor_pose: expected finite positions and unit quaternions, found [nan, "),
    "quaternion": (wrong(lambda r: r.sensor_pose.start_pose.ClearField("quat")), "INVALID_ARGUMENT", "sensor_pose: expected finite positions and unit quaternions"),
    "no pose": (wrong(lambda r: r.ClearField("sensor_pose")), "INVALID_ARGUMENT", "sensor_pose: expected finite positions and unit quaternions"),
    "box": (wrong(lambda r: setattr(r.dynamic_objects[0].pose_pair.end_pose.vec, "z", float("inf"))), "INVALID_ARGUMENT", "pose_pair of track "),
    "size": (wrong(lambda r: setattr(r, "resolution_h", 16385)), "INVALID_ARGUMENT", "expected an image size of 1 to 16384 pixels, found 16385x200"),
    "pixels": (wrong(lambda r: (setattr(r, "resolution_h", 16384), setattr(r, "resolution_w", 16384))), "RESOURCE_EXHAUSTED", "expected at most 256 images and 67108864 pixels in a request, found 1 and 268435456"),
    "focal": (wrong(lambda r: setattr(r.camera_intrinsics.opencv_pinhole_param, "focal_length_x", 0.0)), "INVALID_ARGUMENT", "expected finite intrinsics with positive focal lengths"),
    "format": (wrong(lambda r: setattr(r, "image_format", sensorsim_pb2.AV1)), "INVALID_ARGUMENT", "expected image_format PNG or JPEG, found AV1"),
    "no format": (wrong(lambda r: r.ClearField("image_format")), "INVALID_ARGUMENT", "expected image_format PNG or JPEG, found UNDEFINED"),
    "quality": (wrong(lambda r: setattr(r, "image_quality", float("nan"))), "INVALID_ARGUMENT", "expected image_quality of 0 to 100, found nan"),
    "windshield": (wrong(lambda r: r.camera_intrinsics.bivariate_windshield_model_param.SetInParent()), "UNIMPLEMENTED", "expected a camera without a windshield"),
    "coefficients": (wrong(lambda r: r.camera_intrinsics.opencv_pinhole_param.radial_coeffs.append(1.0)), "INVALID_ARGUMENT", "expected at most 6 finite radial_coeffs"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_requests_have_their_status(towns: Towns, client: Any, name: str) -> None:
    change, code, text = WRONG[name]
    asked = towns.requests(client)
    camera, request = next(iter(asked.items()))
    change(request)
    with pytest.raises(grpc.RpcError) as error:
        client.render_rgb(request)
    assert error.value.code().name == code and error.value.details().startswith(text), error.value.details()
    if name == "pixels":
        return
    # In a batch the other items are rendered.
    items = client.batch_render_rgb(batch(asked)).items
    assert [item.success for item in items] == [False, True, True, True, True, True]
    assert items[0].camera_name == camera and items[0].error_message.startswith(f"{code}: {text}")


def test_wrong_messages_have_their_status(towns: Towns, client: Any) -> None:
    asked = towns.requests(client)
    request = next(iter(asked.values()))
    double = batch(asked)
    double.items[1].camera_name = double.items[0].camera_name
    lidar = sensorsim_pb2.LidarRenderRequest(scene_id=request.scene_id)
    many = sensorsim_pb2.AggregatedRenderRequest(rgb_requests=[request] * 257)
    large = Request.FromString(request.SerializeToString())
    large.camera_intrinsics.temporary_camera_spec = "x" * (65 << 20)
    for call, message, code in (
        (client.batch_render_rgb, double, "INVALID_ARGUMENT"),
        (client.render_aggregated, many, "RESOURCE_EXHAUSTED"),
        (client.render_rgb, large, "RESOURCE_EXHAUSTED"),
        (client.render_aggregated, sensorsim_pb2.AggregatedRenderRequest(lidar_requests=[lidar] * 9), "RESOURCE_EXHAUSTED"),
        (client.render_lidar, sensorsim_pb2.LidarRenderRequest(), "NOT_FOUND"),
        (client.render_lidar, sensorsim_pb2.LidarRenderRequest(scene_id=request.scene_id, frame_start_us=1), "INVALID_ARGUMENT"),
        (client.get_available_cameras, sensorsim_pb2.AvailableCamerasRequest(scene_id="x"), "NOT_FOUND"),
        (client.get_available_trajectories, sensorsim_pb2.AvailableTrajectoriesRequest(scene_id="x"), "NOT_FOUND"),
    ):
        with pytest.raises(grpc.RpcError) as error:
            call(message)
        assert error.value.code().name == code, error.value.details()
    # The server continues.
    assert client.render_rgb(request).image_bytes


def test_sweeps_are_in_the_frame_of_the_device_at_their_end(towns: Towns, client: Any) -> None:
    log, skeleton = towns.logs[0], towns.skeletons[0]
    scene = log[2]
    before = log.at(scene.t_us - 100_000)
    mount = np.eye(4)
    mount[:3, 3] = log.lidar_position
    start, end = (poses.pose(at.ego @ mount, poses.local_origin(log.at(log.times_us[0]).ego[:3, 3])) for at in (before, scene))
    asked = next(iter(towns.requests(client).values()))
    request = sensorsim_pb2.LidarRenderRequest(
        scene_id=log.name,
        lidar_config={"lidar_type": sensorsim_pb2.AT128},
        frame_start_us=before.t_us,
        frame_end_us=scene.t_us,
        sensor_pose={"start_pose": start, "end_pose": end},
        dynamic_objects=asked.dynamic_objects,
    )
    answer = client.render_lidar(request)
    points = np.frombuffer(answer.point_xyzs_buffer, "<f4").reshape(-1, 3)
    assert len(points) == answer.num_points > 10_000 and len(answer.point_intensities_buffer) == 4 * len(points)
    # The actors of the request stand still.
    still = pskel.Scene(before.ego, [], scene.actors, t_us=before.t_us)
    with pskel.Renderer(pskel.Skeleton(skeleton), maps=["depth"], log=log.name) as renderer:
        expected = renderer.lidar(pskel.Scene(scene.ego, [], scene.actors, t_us=scene.t_us), "at128", other=still, position=log.lidar_position)
    assert len(points) == len(expected["points"])
    np.testing.assert_allclose(points + np.array(log.lidar_position), expected["points"], atol=2e-3)
    both = sensorsim_pb2.AggregatedRenderRequest(rgb_requests=[asked], lidar_requests=[request])
    assert client.render_aggregated(both).lidar_returns[0] == answer


def test_bytes_that_are_no_message(towns: Towns) -> None:
    with server(*towns.arguments) as (process, address):
        raw = grpc.insecure_channel(address).unary_unary("/nre.grpc.protos.sensorsim.SensorsimService/render_rgb")
        with pytest.raises(grpc.RpcError) as error:
            raw(b"\xff" * 1000)
        assert error.value.code() is grpc.StatusCode.INTERNAL
        assert stub(address).get_version(EMPTY).version_id
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0


def test_a_server_is_killed_and_started_again_between_requests(towns: Towns) -> None:
    with server(*towns.arguments) as (process, address):
        asked = towns.requests(stub(address))
        before = stub(address).batch_render_rgb(batch(asked))
        process.kill()
        process.wait()
        client = stub(address)
        with pytest.raises(grpc.RpcError) as error:
            client.batch_render_rgb(batch(asked))
        assert error.value.code() is grpc.StatusCode.UNAVAILABLE
        with server(*towns.arguments, f"--port={address.rpartition(':')[2]}"):
            assert client.batch_render_rgb(batch(asked), wait_for_ready=True, timeout=60) == before


def test_deadlines_and_callers_that_leave(towns: Towns) -> None:
    with server(*towns.arguments, "--threads=1") as (_, address):
        client = stub(address)
        asked = towns.requests(client)
        with pytest.raises(grpc.RpcError) as error:
            client.batch_render_rgb(batch(asked), timeout=0.001)
        assert error.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED
        # Work for callers that have left is skipped, so that the next one is answered soon.
        waiting = [client.batch_render_rgb.future(batch(asked)) for _ in range(30)]  # type: ignore[attr-defined]
        time.sleep(0.3)
        for call in waiting:
            call.cancel()
        start = time.monotonic()
        assert client.batch_render_rgb(batch(asked)).items[0].success
        once = time.monotonic() - start
        assert once < 20.0


def test_holes_are_filled(towns: Towns) -> None:
    with server(*towns.arguments[:-1]) as (_, address):
        client = stub(address)
        asked = towns.requests(client)
        found = np.stack([decoded(item.result.image_bytes) for item in client.batch_render_rgb(batch(asked)).items])
    renderer = pskel.Renderer(pskel.Skeleton(towns.skeletons[0]), maps=["color", "depth"], log=towns.logs[0].name)
    maps = renderer.render(towns.logs[0][2])
    np.testing.assert_array_equal(found, pskel.fill_holes(maps["color"], maps["depth"]))
    known = np.isfinite(maps["depth"])
    assert not known.all() and (found[known] == maps["color"][known]).all()
    assert (found[~known] != 0).any(axis=-1).mean() > 0.9


def test_filled_holes_are_means_of_what_is_around() -> None:
    color = np.zeros((1, 8, 8, 3), np.uint8)
    depth = np.full((1, 8, 8), np.inf, np.float32)
    color[0, :, 0], depth[0, :, 0] = (200, 100, 50), 5.0
    assert (pskel.fill_holes(color, depth) == np.array([200, 100, 50])).all()
    color[0, :, 7], depth[0, :, 7] = (0, 100, 150), 5.0
    filled = pskel.fill_holes(color, depth)[0].astype(int)
    assert (np.diff(filled[3, :, 0]) <= 0).all() and (np.diff(filled[3, :, 2]) >= 0).all() and (filled[..., 1] == 100).all()
    with pytest.raises(ValueError, match=r"expected color \[V, H, W, 3\] and depth \[V, H, W\], found \[1, 8, 8, 3\] and \[1, 8, 7\]"):
        pskel.fill_holes(color, depth[..., :7])


Points = NDArray[np.float64]


def pinhole_forward(x: Points, y: Points, k: Points, p: Points, s: Points) -> tuple[Points, Points]:
    """OpenCV's projectPoints for the plane z = 1, written out."""
    r2 = x**2 + y**2
    radial = (1 + k[0] * r2 + k[1] * r2**2 + k[2] * r2**3) / (1 + k[3] * r2 + k[4] * r2**2 + k[5] * r2**3)
    u = x * radial + 2 * p[0] * x * y + p[1] * (r2 + 2 * x**2) + s[0] * r2 + s[1] * r2**2
    v = y * radial + p[0] * (r2 + 2 * y**2) + 2 * p[1] * x * y + s[2] * r2 + s[3] * r2**2
    return u, v


def shown(projection: cameras.Projection) -> tuple[Points, Points, NDArray[np.bool_]]:
    """Points of the plane z = 1 at the centers of the pinhole pixels that an image shows, and which pixels show any."""
    assert projection.source is not None
    row, column = np.divmod(projection.source, projection.size[1])
    (fx, _, cx), (_, fy, cy), _ = projection.intrinsics
    return (column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy, projection.source >= 0


def test_lenses_show_what_their_models_say() -> None:
    size = (120, 200)
    rows, columns = np.mgrid[:120, :200]
    u, v = columns + 0.5, rows + 0.5
    param = {"principal_point_x": 101.0, "principal_point_y": 58.0, "focal_length_x": 150.0, "focal_length_y": 155.0}
    k, p, s = np.array([-0.28, 0.11, -0.01, 0.02, 0.01, 0.0]), np.array([1e-3, -2e-3]), np.array([1e-3, 0.0, -1e-3, 1e-4])
    pinhole = sensorsim_pb2.OpenCVPinholeCameraParam(**param, radial_coeffs=k, tangential_coeffs=p, thin_prism_coeffs=s)
    x, y, known = shown(cameras.projection(sensorsim_pb2.CameraSpec(opencv_pinhole_param=pinhole), size))
    assert known.all()
    found = pinhole_forward(x, y, k, p, s)
    # Within half a pinhole pixel, which the lens makes at most a little larger here.
    assert np.abs(found[0] * 150.0 + 101.0 - u).max() < 0.75 and np.abs(found[1] * 155.0 + 58.0 - v).max() < 0.75
    fisheye = sensorsim_pb2.OpenCVFisheyeCameraParam(**param, radial_coeffs=[0.05, -0.01, 0.002, 0.0])
    x, y, known = shown(cameras.projection(sensorsim_pb2.CameraSpec(opencv_fisheye_param=fisheye), size))
    assert known.all()
    theta = np.arctan(np.hypot(x, y))
    distance = theta * (1 + 0.05 * theta**2 - 0.01 * theta**4 + 0.002 * theta**6) / np.hypot(x, y)
    assert np.abs(x * distance * 150.0 + 101.0 - u).max() < 0.75 and np.abs(y * distance * 155.0 + 58.0 - v).max() < 0.75
    # The polynomials of an f-theta camera are inverses of each other: both give the same picture.
    kind = sensorsim_pb2.FthetaCameraParam
    forward = np.array([0.0, 90.0, 0.0, -4.0])
    angle = np.linspace(0.0, 1.3, 400)
    distances = np.polynomial.polynomial.polyval(angle, forward)
    backward = np.polynomial.polynomial.polyfit(distances, angle, [1, 2, 3, 4, 5, 6, 7])
    param = {"principal_point_x": 101.0, "principal_point_y": 58.0}
    by_angle = kind(**param, reference_poly=kind.ANGLE_TO_PIXELDIST, angle_to_pixeldist_poly=forward)
    by_pixel = kind(**param, reference_poly=kind.PIXELDIST_TO_ANGLE, pixeldist_to_angle_poly=backward)
    both = [cameras.projection(sensorsim_pb2.CameraSpec(ftheta_param=f), size) for f in (by_angle, by_pixel)]
    for projection in both:
        x, y, known = shown(projection)
        assert known.mean() > 0.95
        theta = np.arctan(np.hypot(x, y))
        scale = np.polynomial.polynomial.polyval(theta, forward) / np.hypot(x, y)
        near = known & (theta < 1.0)
        assert np.abs((x * scale + 101.0 - u)[near]).max() < 0.75 and np.abs((y * scale + 58.0 - v)[near]).max() < 0.75
    # Twice the size shows the same.
    spec = sensorsim_pb2.CameraSpec(ftheta_param=by_angle, resolution_h=120, resolution_w=200)
    x, y, known = shown(cameras.projection(spec, (240, 400)))
    x1, y1, _ = shown(both[0])
    near = known[::2, ::2] & (np.hypot(x1, y1) < 1.5)
    assert np.abs(x[::2, ::2] - x1)[near].max() < 0.03 and np.abs(y[::2, ::2] - y1)[near].max() < 0.03


def test_lenses_that_cannot_be_shown() -> None:
    param = {"principal_point_x": 100.0, "principal_point_y": 60.0, "focal_length_x": 150.0, "focal_length_y": 150.0}
    kind = sensorsim_pb2.FthetaCameraParam
    for spec, text in (
        ({}, "expected the parameters of a camera, found none"),
        ({"opencv_fisheye_param": {**param, "radial_coeffs": [float("nan")]}}, "expected at most 4 finite radial_coeffs"),
        ({"ftheta_param": kind(reference_poly=kind.PIXELDIST_TO_ANGLE)}, "expected finite f-theta polynomials that rise from 0"),
        ({"ftheta_param": kind(angle_to_pixeldist_poly=[0.0, -1.0])}, "expected finite f-theta polynomials that rise from 0"),
        ({"ftheta_param": kind(angle_to_pixeldist_poly=[0.0, 9.0], linear_cde={"linear_c": 1.0, "linear_d": 1.0, "linear_e": 1.0})}, "expected an invertible linear_cde"),
        ({"ftheta_param": kind(principal_point_x=100.0, principal_point_y=60.0, angle_to_pixeldist_poly=[0.0, 9000.0]), "resolution_h": 10, "resolution_w": 10}, "expected an image of the camera's aspect ratio"),
        ({"opencv_pinhole_param": {**param, "radial_coeffs": [-1e6]}}, "expected a lens"),
    ):  # fmt: skip
        with pytest.raises(RequestError) as error:
            cameras.projection(sensorsim_pb2.CameraSpec(**spec), (120, 200))
        assert str(error.value).startswith(text), error.value


def test_a_distorted_camera_on_the_server(towns: Towns, client: Any) -> None:
    """Each pixel is one of the pinhole image, which the renderer makes too."""
    asked = towns.requests(client)
    request = next(iter(asked.values()))
    request.camera_intrinsics.opencv_pinhole_param.radial_coeffs[:] = [-0.2, 0.05, 0.0, 0.0, 0.0, 0.0]
    found = decoded(client.render_rgb(request).image_bytes)
    projection = cameras.projection(request.camera_intrinsics, found.shape[:2])
    assert projection.source is not None and projection.size > found.shape[:2]
    scene = towns.logs[0][2]
    mount = np.linalg.inv(scene.camera_from_global[0] @ scene.ego)
    camera = pskel.Camera("a", projection.intrinsics, projection.size, mount)
    renderer = pskel.Renderer(pskel.Skeleton(towns.skeletons[0]), maps=["color"], log=towns.logs[0].name)
    whole = renderer.render(pskel.Scene(scene.ego, [camera], scene.actors))["color"][0]
    np.testing.assert_array_equal(found, whole.reshape(-1, 3)[projection.source])


def test_mistakes_of_the_command(towns: Towns, tmp_path: Path) -> None:
    import subprocess
    import sys

    one, two = map(str, towns.skeletons)
    with server(*towns.arguments) as (_, address):
        port = address.rpartition(":")[2]
        for arguments, code, text in (
            ([one, f"--log={towns.names[1]}", "--port=0"], 1, "expected one skeleton with log town-8-6f-overcast"),
            ([one, two, f"--log={towns.names[0]}", "--port=0"], 1, "expected --log for one of town-8-6f-overcast, the logs of "),
            ([str(tmp_path), f"--log={towns.names[0]}", "--port=0"], 1, "pskel.serve: "),
            ([one, f"--log={towns.names[0]}", f"--port={port}"], 1, f"expected an address to listen on, found 127.0.0.1:{port}, which is in use"),
            ([one, f"--log={towns.names[0]}", "--port=0", "--threads=0"], 2, "expected --open-scenes and --threads of at least 1"),
        ):  # fmt: skip
            done = subprocess.run([sys.executable, "-m", "pskel.serve", *arguments], capture_output=True, text=True, check=False, timeout=60)
            assert done.returncode == code and text in done.stderr, done.stderr
