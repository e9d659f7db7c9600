"""The world model of AlpaSim: images equal those of a loop in one process, sessions are independent, failures have their status."""

import io
import signal
import time
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest

grpc = pytest.importorskip("grpc")
pytest.importorskip("PIL")
from pskel.alpasim import API_VERSION, common_pb2, poses, sensorsim_pb2, video_model_pb2  # noqa: E402
from sensorsim_client import decoded, run  # noqa: E402
from world_client import FAKES, INTERVAL_US, chunk, encoded, in_process, pictures, server, session, stub, wait  # noqa: E402
from world_fakes import Fake  # noqa: E402

Chunk = video_model_pb2.VideoChunkRequest
Start = video_model_pb2.SessionRequest
SIZE = (56, 100)
CAMERA_FROM_OPTICAL = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
LOGS = [f"town:seed={seed},frames=16,size=56x100" for seed in (7, 8)]


class Towns:
    """Two logs with skeletons."""

    def __init__(self, folder: Path) -> None:
        self.logs = [pskel.Log(log) for log in LOGS]
        self.skeletons = [folder / f"skeleton{number}" for number in range(len(LOGS))]
        for log, skeleton in zip(LOGS, self.skeletons, strict=True):
            run("build", log, "--frames=0..3", f"--out={skeleton}")
        self.one = [str(self.skeletons[0]), f"--log={LOGS[0]}"]
        self.two = [*map(str, self.skeletons), *(f"--log={log}" for log in LOGS)]
        self.anchor_us = [log.times_us[0] + 200_000 for log in self.logs]

    def start(self, number: int = 0, **fields: Any) -> Start:
        return session(self.logs[number], self.anchor_us[number], SIZE, **fields)

    def chunk(self, name: str, first: int, frames: int, number: int = 0, **fields: Any) -> Chunk:
        return chunk(name, self.logs[number], self.anchor_us[number] + (1 + first) * INTERVAL_US, frames, **fields)

    def expected(self, generator: str, start: Start, chunks: list[Chunk], number: int = 0, kind: Any = Fake) -> Any:
        log, skeleton = self.logs[number], pskel.Skeleton(self.skeletons[number])
        renderer = pskel.Renderer(skeleton, maps=["color", "depth"], log=log.name)
        cameras, first = cameras_of(start), log.at(log.times_us[0])
        options = {"log": log.name, "prompt": start.text_prompt.positive, "noise_seed": start.random_seed}
        made = kind(generator, pskel.Scene(first.ego, cameras, map_of=first), fps=30.0, **options)
        references = np.stack([decoded(frame.data) for frame in start.initial_frames])
        return in_process(made, renderer, log, start, chunks, cameras, references)


def cameras_of(request: Start) -> list[pskel.Camera]:
    """The pinhole cameras of a session as its message holds them."""
    made = []
    for spec, mount in zip(request.camera_specs, request.rig_to_camera, strict=True):
        param = spec.opencv_pinhole_param
        k = [[param.focal_length_x, 0, param.principal_point_x], [0, param.focal_length_y, param.principal_point_y], [0, 0, 1]]
        ego_from_camera = poses.matrix(mount) @ CAMERA_FROM_OPTICAL
        made.append(pskel.Camera(spec.logical_id, k, (spec.resolution_h, spec.resolution_w), ego_from_camera))
    return made


@pytest.fixture(scope="module")
def towns(tmp_path_factory: pytest.TempPathFactory) -> Towns:
    return Towns(tmp_path_factory.mktemp("towns"))


@pytest.fixture(scope="module")
def client(towns: Towns) -> Iterator[Any]:
    with server(*towns.one, "--generator=fake:1:3", "--sessions=2", program=FAKES) as (_, address):
        yield stub(address)


@pytest.fixture
def started(client: Any, towns: Towns) -> Iterator[str]:
    name = client.start_session(towns.start()).session_id
    yield name
    try:
        client.close_session(video_model_pb2.SessionCloseRequest(session_id=name))
    except grpc.RpcError as error:
        assert error.code() is grpc.StatusCode.NOT_FOUND


def closed(client: Any, name: str) -> None:
    assert client.close_session(video_model_pb2.SessionCloseRequest(session_id=name)) == common_pb2.Empty()


def hdmap(*names: str) -> video_model_pb2.StaticWorldMap:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name in names:
            archive.writestr(name, b"PAR1")
    return video_model_pb2.StaticWorldMap(hdmap_parquets=out.getvalue())


@pytest.mark.parametrize("generator", ["fake:1:3", "fake:4:20"])
def test_interleaved_sessions_equal_the_loop_in_one_process(towns: Towns, generator: str) -> None:
    lengths = [5, 8, 1, 4]
    fields = [
        {"text_prompt": {"positive": "a sunny street"}, "random_seed": 5},
        {"static_world_map": hdmap(f"{towns.logs[1].name}.lane.parquet", f"{towns.logs[1].name}.clip.parquet")},
    ]
    fields[0]["static_world_map"] = hdmap(f"{towns.logs[0].name}.lane.parquet")
    starts = [towns.start(number, **fields[number]) for number in range(2)]
    with server(*towns.two, f"--generator={generator}", program=FAKES) as (_, address):
        client = stub(address)
        names = [client.start_session(start).session_id for start in (*starts, starts[0])]
        moved = [(0, 0.0), (1, 0.0), (0, -0.75)]
        chunks: list[list[Chunk]] = [[], [], []]
        answers: list[list[Any]] = [[], [], []]
        for turn, frames in enumerate(lengths):
            first = sum(lengths[:turn])
            with ThreadPoolExecutor(3) as pool:
                for index, (number, left_m) in enumerate(moved):
                    fields = {"left_m": left_m, "shuffle": turn + index}
                    chunks[index].append(towns.chunk(names[index], first, frames, number, **fields))
                for index, answer in enumerate(pool.map(client.render_video_chunk, [own[-1] for own in chunks])):
                    answers[index].append(answer)
        for name in names:
            closed(client, name)
    for index, (number, _) in enumerate(moved):
        found = pictures(answers[index])
        assert found.shape == (sum(lengths), 6, *SIZE, 3)
        assert [output.camera_logical_id for output in answers[index][0].camera_outputs] == towns.logs[number][0].cameras
        assert {image.format for answer in answers[index] for output in answer.camera_outputs for image in output.rgb_frames} == {
            video_model_pb2.PNG
        }
        np.testing.assert_array_equal(found, towns.expected(generator, starts[number], chunks[index], number))
    assert (pictures(answers[0]) != pictures(answers[2])).mean() > 0.3


def test_version_and_service_without_generator(towns: Towns, client: Any) -> None:
    version = client.get_version(common_pb2.Empty())
    api = version.grpc_api_version
    assert version.version_id == f"pskel {pskel.__version__}" and (api.major, api.minor, api.patch) == API_VERSION
    with server(*towns.one) as (_, address), pytest.raises(grpc.RpcError) as error:
        stub(address).start_session(towns.start())
    assert error.value.code() is grpc.StatusCode.UNIMPLEMENTED


def change(function: Callable[[Any], object]) -> Callable[[Any], object]:
    return function


def trajectory(request: Chunk) -> Any:
    return request.rig_trajectory.poses


WRONG_CHUNKS = {
    "session": (change(lambda r: setattr(r.session_id, "session_id", "x")), "NOT_FOUND", "expected a session that was started here and has not ended, found 'x'"),
    "empty": (change(lambda r: r.rig_trajectory.Clear()), "INVALID_ARGUMENT", "expected a rig_trajectory of 1 to 256 poses, one per frame, found 0"),
    "long": (change(lambda r: trajectory(r).extend(52 * list(trajectory(r)))), "INVALID_ARGUMENT", "expected a rig_trajectory of 1 to 256 poses, one per frame, found 265"),
    "rate": (change(lambda r: [setattr(at, "timestamp_us", 3 * at.timestamp_us) for at in trajectory(r)]), "INVALID_ARGUMENT", "expected frames every 33333 us (--fps 30), found "),
    "order": (change(lambda r: trajectory(r).reverse()), "INVALID_ARGUMENT", "expected frames every 33333 us (--fps 30), found "),
    "nan": (change(lambda r: setattr(trajectory(r)[1].pose.vec, "y", float("nan"))), "INVALID_ARGUMENT", "rig_trajectory 1: expected finite positions and unit quaternions"),
    "quaternion": (change(lambda r: trajectory(r)[2].pose.ClearField("quat")), "INVALID_ARGUMENT", "rig_trajectory 2: expected finite positions and unit quaternions"),
    "class": (change(lambda r: setattr(r.dynamic_state.actors[3], "class_id", 0)), "INVALID_ARGUMENT", "expected class_id of actor 3 from CAR to OTHER, found INVALID"),
    "size": (change(lambda r: setattr(r.dynamic_state.actors[0].bbox_dims, "size_z", 0.0)), "INVALID_ARGUMENT", "expected bbox_dims of actor 0 above 0 and below 1000 m"),
    "actor's time": (change(lambda r: setattr(r.dynamic_state.actors[0].trajectory.poses[0], "timestamp_us", 7)), "INVALID_ARGUMENT", "expected rising times of frames in the trajectory of actor 0, found 7"),
    "actor's pose": (change(lambda r: setattr(r.dynamic_state.actors[0].trajectory.poses[0].pose.vec, "x", float("inf"))), "INVALID_ARGUMENT", "trajectory of actor 0: expected finite positions"),
    "actors": (change(lambda r: r.dynamic_state.actors.extend(r.dynamic_state.actors[:1] * 4096)), "RESOURCE_EXHAUSTED", "expected at most 4096 actors, found "),
    "origin": (change(lambda r: [setattr(at.pose.vec, "x", at.pose.vec.x + 500.0) for at in trajectory(r)]), "FAILED_PRECONDITION", "expected a first pose within 10 m of the ego of town-7-16f"),
    "before the log": (change(lambda r: (r.ClearField("dynamic_state"), [setattr(at, "timestamp_us", at.timestamp_us - 1_000_000) for at in trajectory(r)])), "FAILED_PRECONDITION", "expected first frames at a time of town-7-16f"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_CHUNKS)
def test_wrong_chunks_have_their_status_and_change_nothing(towns: Towns, client: Any, started: str, name: str) -> None:
    function, code, text = WRONG_CHUNKS[name]
    request = towns.chunk(started, 0, 5)
    right = Chunk.FromString(request.SerializeToString())
    function(request)
    with pytest.raises(grpc.RpcError) as error:
        client.render_video_chunk(request)
    assert error.value.code().name == code and error.value.details().startswith(text), error.value.details()
    found = pictures([client.render_video_chunk(right)])
    np.testing.assert_array_equal(found, towns.expected("fake:1:3", towns.start(), [right]))


def test_chunks_out_of_order_and_closed_sessions(towns: Towns, client: Any, started: str) -> None:
    requests = [towns.chunk(started, first, 5) for first in (0, 5, 10)]
    answers = [client.render_video_chunk(requests[0])]
    for wrong in (requests[0], requests[2]):
        with pytest.raises(grpc.RpcError) as error:
            client.render_video_chunk(wrong)
        expected = towns.anchor_us[0] + round(5 * INTERVAL_US + 1e6 / 30)
        assert error.value.code() is grpc.StatusCode.FAILED_PRECONDITION
        found = wrong.rig_trajectory.poses[0].timestamp_us
        assert error.value.details() == f"expected the next frame at {expected} us (--fps 30), found {found}"
    answers += [client.render_video_chunk(request) for request in requests[1:]]
    np.testing.assert_array_equal(pictures(answers), towns.expected("fake:1:3", towns.start(), requests))
    closed(client, started)
    for call, message in (
        (client.render_video_chunk, requests[0]),
        (client.close_session, video_model_pb2.SessionCloseRequest(session_id=started)),
    ):
        with pytest.raises(grpc.RpcError) as error:
            call(message)
        assert error.value.code() is grpc.StatusCode.NOT_FOUND


def spec(request: Start) -> Any:
    return request.camera_specs[1]


def turn_optical(request: Start) -> None:
    """Give the axes of the optical frame, as the sensor renderer has them."""
    request.rig_to_camera[1].CopyFrom(poses.pose(poses.matrix(request.rig_to_camera[1]) @ CAMERA_FROM_OPTICAL))


WRONG_STARTS = {
    "cameras": (change(lambda r: r.ClearField("camera_specs")), "INVALID_ARGUMENT", "expected as many camera_specs, initial_frames and rig_to_camera, 1 to 8, found 0, 6 and 6"),
    "frames": (change(lambda r: r.initial_frames.pop()), "INVALID_ARGUMENT", "expected as many camera_specs, initial_frames and rig_to_camera, 1 to 8, found 6, 5 and 6"),
    "many": (change(lambda r: [getattr(r, name).extend(2 * list(getattr(r, name))) for name in ("camera_specs", "initial_frames", "rig_to_camera")]), "INVALID_ARGUMENT", "expected as many camera_specs, initial_frames and rig_to_camera, 1 to 8, found 18, 18 and 18"),
    "twice": (change(lambda r: setattr(spec(r), "logical_id", r.camera_specs[0].logical_id)), "INVALID_ARGUMENT", "expected camera_specs with different logical_id"),
    "no name": (change(lambda r: setattr(spec(r), "logical_id", "")), "INVALID_ARGUMENT", "expected camera_specs with different logical_id"),
    "no parameters": (change(lambda r: spec(r).ClearField("opencv_pinhole_param")), "INVALID_ARGUMENT", "camera CAM_FRONT_RIGHT: expected the parameters of a camera, found none"),
    "focal": (change(lambda r: setattr(spec(r).opencv_pinhole_param, "focal_length_x", -1.0)), "INVALID_ARGUMENT", "camera CAM_FRONT_RIGHT: expected finite intrinsics"),
    "pose": (change(lambda r: r.rig_to_camera[1].Clear()), "INVALID_ARGUMENT", "rig_to_camera of CAM_FRONT_RIGHT: expected finite positions and unit quaternions"),
    "optical": (turn_optical, "INVALID_ARGUMENT", "camera CAM_FRONT_RIGHT: expected rig_to_camera of a camera whose axes are forward, left, up, found one whose axes are right, down, forward"),
    "format": (change(lambda r: setattr(r.initial_frames[1], "format", video_model_pb2.AV1)), "INVALID_ARGUMENT", "camera CAM_FRONT_RIGHT: expected an initial frame as PNG or JPEG, found AV1"),
    "other format": (change(lambda r: setattr(r.initial_frames[1], "format", video_model_pb2.JPEG)), "INVALID_ARGUMENT", "camera CAM_FRONT_RIGHT: expected an initial frame as JPEG, found "),
    "half": (change(lambda r: setattr(r.initial_frames[1], "data", r.initial_frames[1].data[:500])), "INVALID_ARGUMENT", "camera CAM_FRONT_RIGHT: expected an initial frame as PNG, found 500 bytes: "),
    "resolution": (change(lambda r: setattr(spec(r), "resolution_h", 20000)), "INVALID_ARGUMENT", "camera CAM_FRONT_RIGHT: expected "),
    "pixels": (change(lambda r: [setattr(one, name, 4000) for one in r.camera_specs for name in ("resolution_h", "resolution_w")]), "RESOURCE_EXHAUSTED", "expected cameras of at most 67108864 pixels, found 96000000"),
    "intrinsics of the resolution": (change(lambda r: (setattr(spec(r), "resolution_h", 112), setattr(spec(r), "resolution_w", 200), setattr(spec(r).opencv_pinhole_param, "principal_point_x", 100.0), setattr(spec(r).opencv_pinhole_param, "principal_point_y", 56.0))), "INVALID_ARGUMENT", "camera CAM_FRONT_RIGHT: expected intrinsics in pixels of the first frame, 56x100, found a principal point at [100.0, 56.0]"),
    "no zip": (change(lambda r: setattr(r.static_world_map, "hdmap_parquets", b"PK" * 100)), "INVALID_ARGUMENT", "expected hdmap_parquets as a zip, found 200 bytes: "),
    "two clips": (change(lambda r: r.static_world_map.CopyFrom(hdmap("a.lane.parquet", "b.lane.parquet"))), "INVALID_ARGUMENT", "expected hdmap_parquets with files CLIP.NAME.parquet of one clip, found ['a', 'b']"),
    "no clip": (change(lambda r: r.static_world_map.CopyFrom(hdmap("lane.parquet"))), "INVALID_ARGUMENT", "expected hdmap_parquets with files CLIP.NAME.parquet of one clip, found ['']"),
    "other clip": (change(lambda r: r.static_world_map.CopyFrom(hdmap("0d2f.lane.parquet"))), "NOT_FOUND", "expected hdmap_parquets of a scene among town-7-16f"),
    "generator refuses": (change(lambda r: setattr(r.text_prompt, "positive", "refused")), "INVALID_ARGUMENT", "the generator takes no such session: expected a generator fake"),
    "generator does not start": (change(lambda r: setattr(r.text_prompt, "positive", "broken")), "UNAVAILABLE", "the generator does not start: expected a process that starts"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_STARTS)
def test_wrong_starts_have_their_status(towns: Towns, client: Any, name: str) -> None:
    function, code, text = WRONG_STARTS[name]
    request = towns.start()
    function(request)
    with pytest.raises(grpc.RpcError) as error:
        client.start_session(request)
    assert error.value.code().name == code and error.value.details().startswith(text), error.value.details()
    assert "\n" not in error.value.details()


def test_scenes_are_named_by_the_clip(towns: Towns) -> None:
    names = ", ".join(sorted(log.name for log in towns.logs))
    with server(*towns.two, "--generator=fake:1:3", program=FAKES) as (_, address):
        client = stub(address)
        with pytest.raises(grpc.RpcError) as error:
            client.start_session(towns.start())
        assert error.value.code() is grpc.StatusCode.FAILED_PRECONDITION
        assert error.value.details() == (
            f"expected hdmap_parquets that name one of {names}, found none: send them, or serve one scene per process"
        )
        start = towns.start(1, static_world_map=hdmap("map.txt", f"{towns.logs[1].name}.lane.parquet"))
        name = client.start_session(start).session_id
        request = towns.chunk(name, 0, 2, 1)
        found = pictures([client.render_video_chunk(request)])
        np.testing.assert_array_equal(found, towns.expected("fake:1:3", start, [request], 1))


def test_sessions_are_limited(towns: Towns) -> None:
    start = towns.start()
    with server(*towns.one, "--generator=fake:1:3", "--sessions=2", program=FAKES) as (_, address):
        client = stub(address)
        names = [client.start_session(start).session_id for _ in range(2)]
        with pytest.raises(grpc.RpcError) as error:
            client.start_session(start)
        assert error.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        assert error.value.details() == "expected at most 2 sessions (--sessions), found as many that have not ended"
        closed(client, names[0])
        client.start_session(start)
        assert client.render_video_chunk(towns.chunk(names[1], 0, 1)).camera_outputs


def test_idle_sessions_end(towns: Towns) -> None:
    start = towns.start()
    with server(*towns.one, "--generator=fake:1:3", "--sessions=1", "--idle=8", program=FAKES) as (_, address):
        client = stub(address)
        name = client.start_session(start).session_id
        request = towns.chunk(name, 0, 1)
        time.sleep(5.0)
        client.render_video_chunk(request)
        time.sleep(4.0)
        with pytest.raises(grpc.RpcError) as error:  # more than 8 s after its start, but not after its last call
            client.start_session(start)
        assert error.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        time.sleep(8.0)
        client.start_session(start)
        with pytest.raises(grpc.RpcError) as error:
            client.render_video_chunk(towns.chunk(name, 1, 1))
        assert error.value.code() is grpc.StatusCode.NOT_FOUND


def test_a_failed_generator_ends_its_session_alone(towns: Towns) -> None:
    with server(*towns.one, "--generator=fake:1:3:dies", program=FAKES) as (_, address):
        client = stub(address)
        names = [client.start_session(towns.start()).session_id for _ in range(2)]
        client.render_video_chunk(towns.chunk(names[1], 0, 2))
        with pytest.raises(grpc.RpcError) as error:
            client.render_video_chunk(towns.chunk(names[0], 0, 5))
        assert error.value.code() is grpc.StatusCode.INTERNAL
        assert error.value.details() == "the generator failed, the session has ended: expected an answer, found the end of the process"
        with pytest.raises(grpc.RpcError) as error:
            client.render_video_chunk(towns.chunk(names[0], 0, 5))
        assert error.value.code() is grpc.StatusCode.NOT_FOUND
        assert client.render_video_chunk(towns.chunk(names[1], 2, 1)).camera_outputs


def test_a_caller_that_leaves_in_a_chunk_ends_its_session(towns: Towns) -> None:
    with server(*towns.one, "--generator=fake:1:3:slow", program=FAKES) as (process, address):
        client = stub(address)
        name = client.start_session(towns.start()).session_id
        with pytest.raises(grpc.RpcError) as error:
            client.render_video_chunk(towns.chunk(name, 0, 8), timeout=0.8)
        assert error.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED
        with pytest.raises(grpc.RpcError) as error:
            client.render_video_chunk(towns.chunk(name, 0, 8))
        assert error.value.code() is grpc.StatusCode.NOT_FOUND
        process.send_signal(signal.SIGTERM)
        wait(lambda: process.poll() == 0)


def test_a_server_that_is_killed_has_no_sessions_when_it_is_started_again(towns: Towns) -> None:
    with server(*towns.one, "--generator=fake:1:3", program=FAKES) as (process, address):
        client = stub(address)
        name = client.start_session(towns.start()).session_id
        before = client.render_video_chunk(towns.chunk(name, 0, 5))
        process.kill()
        process.wait()
        with pytest.raises(grpc.RpcError) as error:
            client.render_video_chunk(towns.chunk(name, 5, 8))
        assert error.value.code() is grpc.StatusCode.UNAVAILABLE
        with server(*towns.one, "--generator=fake:1:3", f"--port={address.rpartition(':')[2]}", program=FAKES):
            with pytest.raises(grpc.RpcError) as error:
                client.render_video_chunk(towns.chunk(name, 5, 8), wait_for_ready=True, timeout=60)
            assert error.value.code() is grpc.StatusCode.NOT_FOUND
            name = client.start_session(towns.start()).session_id
            assert client.render_video_chunk(towns.chunk(name, 0, 5)) == before


def test_messages_have_a_largest_size(towns: Towns) -> None:
    request = towns.start()
    for camera, frame in zip(request.camera_specs, request.initial_frames, strict=True):
        camera.resolution_h, camera.resolution_w = 56 * 16, 1600
        frame.CopyFrom(encoded(decoded(frame.data), "JPEG"))
    with server(*towns.one, "--generator=fake:1:3", program=FAKES) as (_, address):
        client = stub(address)
        name = client.start_session(request).session_id
        with pytest.raises(grpc.RpcError) as error:
            client.render_video_chunk(towns.chunk(name, 0, 5))
        assert error.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        assert error.value.details().startswith("expected at most 67108864 bytes of images in a chunk, found 129024000")
        (answer,) = [client.render_video_chunk(towns.chunk(name, 0, 1))]  # nothing has changed
        assert pictures([answer]).shape == (1, 6, 896, 1600, 3)
        large = towns.start()
        large.static_world_map.hdmap_parquets = bytes(65 << 20)
        with pytest.raises(grpc.RpcError) as error:
            client.start_session(large)
        assert error.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


def test_jpeg(towns: Towns) -> None:
    with server(*towns.one, "--generator=fake:1:3", "--encoding=jpeg", program=FAKES) as (_, address):
        client = stub(address)
        name = client.start_session(towns.start()).session_id
        request = towns.chunk(name, 0, 2)
        answer = client.render_video_chunk(request)
        assert all(frame.format == video_model_pb2.JPEG for output in answer.camera_outputs for frame in output.rgb_frames)
        difference = np.abs(pictures([answer]).astype(int) - towns.expected("fake:1:3", towns.start(), [request]))
        assert difference[..., 1:, :, :].mean() < 12.0


def test_condition_frames_without_and_with_generation(towns: Towns) -> None:
    """The oracle is the renderer: boxes over the HD map."""
    log = towns.logs[0]
    renderer = pskel.Renderer(pskel.Skeleton(towns.skeletons[0]), maps=["map", "boxes"], log=log.name)
    with server(*towns.one, "--generator=fake:1:3", program=FAKES) as (_, address):
        client = stub(address)
        for options in ({"skip_video_generation": True}, {"return_hdmap_frames": True}):
            name = client.start_session(towns.start(debug_options=options)).session_id
            requests = [towns.chunk(name, 0, 2), towns.chunk(name, 2, 1)]
            answers = [client.render_video_chunk(request) for request in requests]
            count = 0 if "skip_video_generation" in options else 2
            assert {len(output.rgb_frames) for output in answers[0].camera_outputs} == {count}
            found = pictures(answers, "hdmap_condition_frames")
            times_us = [at.timestamp_us for request in requests for at in request.rig_trajectory.poses]
            for image, t_us in zip(found, times_us, strict=True):
                maps = renderer.render(log.at(t_us))
                expected = np.where(maps["boxes"].any(axis=-1, keepdims=True), maps["boxes"], maps["map"])
                assert (expected != 0).any(axis=(1, 2, 3)).sum() >= 4
                assert (image == expected).mean() > 0.995  # poses are rounded to 32 bits
    assert (found[0] != found[1]).any()


REAL = ["fill", "network"]


@pytest.mark.parametrize("generator", REAL)
def test_generators_of_simulate_equal_the_loop_in_one_process(towns: Towns, generator: str) -> None:
    start = towns.start(random_seed=3)
    size = pskel.Generator(generator, towns.logs[0][0], fps=30.0).image_size
    del start.initial_frames[:]
    for image in towns.logs[0].images(towns.logs[0].at(towns.anchor_us[0]), size):
        start.initial_frames.append(encoded(image))
    for camera in start.camera_specs:  # of the size of the generator's images, which are then returned as they are
        param, scale = camera.opencv_pinhole_param, np.array(size) / SIZE
        param.focal_length_x, param.principal_point_x = param.focal_length_x * scale[1], param.principal_point_x * scale[1]
        param.focal_length_y, param.principal_point_y = param.focal_length_y * scale[0], param.principal_point_y * scale[0]
        camera.resolution_h, camera.resolution_w = size
    with server(*towns.one, f"--generator={generator}") as (_, address):
        client = stub(address)
        name = client.start_session(start).session_id
        requests = [towns.chunk(name, 0, 2), towns.chunk(name, 2, 1)]
        found = pictures([client.render_video_chunk(request) for request in requests])
    np.testing.assert_array_equal(found, towns.expected(generator, start, requests, kind=pskel.Generator))


def test_mistakes_of_the_command(towns: Towns) -> None:
    import subprocess
    import sys

    for arguments, text in (
        (["--fps=0"], "expected --fps, --sessions, --idle and --generator-timeout above 0"),
        (["--sessions=0"], "expected --fps, --sessions, --idle and --generator-timeout above 0"),
        (["--encoding=av1"], "invalid choice: 'av1'"),
    ):
        command = [sys.executable, "-m", "pskel.serve", *towns.one, "--port=0", "--generator=fill", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 2 and text in done.stderr, done.stderr


def test_a_first_chunk_one_interval_after_the_start_of_the_log(towns: Towns) -> None:
    """AlpaSim rounds the interval down: at 60 Hz the first frames are 0.7 us before the log."""
    log = towns.logs[0]
    with server(*towns.one, "--generator=fake:2:0", "--fps=60", program=FAKES) as (_, address):
        client = stub(address)
        name = client.start_session(towns.start()).session_id
        request = chunk(name, log, log.times_us[0] + 1_000_000 // 60, 1)
        answers = [client.render_video_chunk(request)]
        request.rig_trajectory.poses[0].timestamp_us += 1_000_000 // 60
        request.ClearField("dynamic_state")
        answers.append(client.render_video_chunk(request))
        assert pictures(answers).any(axis=(1, 2, 3, 4)).all()


def test_sensors_are_served_beside(towns: Towns) -> None:
    from sensorsim_client import stub as sensors

    with server(*towns.one, "--generator=fake:1:3", program=FAKES) as (_, address):
        assert list(sensors(address).get_available_scenes(common_pb2.Empty()).scene_ids) == [towns.logs[0].name]
        assert sensorsim_pb2.DESCRIPTOR.package == "nre.grpc.protos.sensorsim"
