"""A client of the world model, written from the messages, and the same rollout in one process."""

import select
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pskel
from numpy.typing import NDArray
from pskel.alpasim import common_pb2, poses, video_model_pb2, video_model_pb2_grpc
from pskel.alpasim.pinhole import pinhole
from sensorsim_client import decoded

Array = NDArray[np.float64]
Pictures = NDArray[np.uint8]
INTERVAL_US = 1_000_000 // 30
#: Optical axes (right, down, forward) as rows of (forward, left, up): the transpose of the matrix below.
OPTICAL_FROM_CAMERA = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
CLASSES = {
    "human.pedestrian.adult": video_model_pb2.PEDESTRIAN,
    "human.pedestrian.child": video_model_pb2.PEDESTRIAN,
    "vehicle.car": video_model_pb2.CAR,
    "vehicle.truck": video_model_pb2.TRUCK,
    "vehicle.bus.rigid": video_model_pb2.TRUCK,
    "vehicle.bicycle": video_model_pb2.CYCLIST,
    "movable_object.trafficcone": video_model_pb2.OTHER,
    "movable_object.barrier": video_model_pb2.OTHER,
}


@contextmanager
def server(*arguments: str, program: Sequence[str] = ("-m", "pskel.serve")) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """A server in a process of its own, whose images are PNG by default; yields it and its address."""
    port = [] if any(argument.startswith("--port") for argument in arguments) else ["--port=0"]
    exact = ["--encoding=png"] if any(argument.startswith("--generator") for argument in arguments) else []
    command = [sys.executable, *program, *exact, *arguments, *port]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=sys.stderr, text=True)
    assert process.stdout is not None
    try:
        ready, _, _ = select.select([process.stdout], [], [], 120.0)
        line = process.stdout.readline() if ready else ""
        assert line.startswith("pskel.serve: "), line
        yield process, line.split()[1].removesuffix(":")
    finally:
        process.kill()
        process.communicate()


def stub(address: str) -> video_model_pb2_grpc.WorldModelServiceStub:
    limits = [("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1)]
    return video_model_pb2_grpc.WorldModelServiceStub(grpc.insecure_channel(address, options=limits))


def origin(log: pskel.Log) -> Array:
    return np.floor(log.at(log.times_us[0]).ego[:3, 3])


def session(log: pskel.Log, anchor_us: int, size: tuple[int, int], **fields: Any) -> video_model_pb2.SessionRequest:
    """A session with the cameras of a log and its images at a time."""
    scene = log.at(anchor_us)
    mounts = np.linalg.inv(scene.ego) @ np.linalg.inv(scene.camera_from_global)
    request = video_model_pb2.SessionRequest(**fields)
    for name, k, shape, mount, image in zip(
        scene.cameras, scene.intrinsics, scene.sizes, mounts, log.images(scene, size), strict=True
    ):
        request.camera_specs.append(pinhole(name, k, shape, mount).intrinsics)
        request.rig_to_camera.append(poses.pose(mount @ OPTICAL_FROM_CAMERA))
        request.initial_frames.append(encoded(image))
    return request


def encoded(image: Pictures, kind: str = "PNG") -> video_model_pb2.Image:
    import io

    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(image).save(out, format=kind)
    return video_model_pb2.Image(data=out.getvalue(), format=video_model_pb2.ImageFormat.Value(kind))


def chunk(
    name: str, log: pskel.Log, first_us: int, frames: int, left_m: float = 0.0, shuffle: int = 0
) -> video_model_pb2.VideoChunkRequest:
    """A chunk of the log, with the ego moved to the left; its actors in another order for each ``shuffle``."""
    times_us = [first_us + number * INTERVAL_US for number in range(frames)]
    scenes = [log.at(t_us).move_ego(left_m=left_m) for t_us in times_us]
    request = video_model_pb2.VideoChunkRequest(session_id=video_model_pb2.SessionId(session_id=name))
    for scene in scenes:
        request.rig_trajectory.poses.append(_at(scene.t_us, scene.ego, origin(log)))
    tracks: dict[str, list[tuple[int, pskel.Actor]]] = {}
    for scene in scenes:
        for actor in scene.actors:
            tracks.setdefault(actor.track, []).append((scene.t_us, actor))
    order = sorted(tracks)
    np.random.default_rng(shuffle).shuffle(order)
    for track in order:
        actor = tracks[track][0][1]
        length, width, height = actor.size
        box = common_pb2.AABB(size_x=length, size_y=width, size_z=height)
        path = common_pb2.Trajectory(poses=[_at(t_us, one.global_from_box, origin(log)) for t_us, one in tracks[track]])
        kind = CLASSES[actor.category]
        request.dynamic_state.actors.add(class_id=kind, bbox_dims=box, trajectory=path)
    return request


def _at(t_us: int, pose: Array, start: Array) -> common_pb2.PoseAtTime:
    return common_pb2.PoseAtTime(pose=poses.pose(pose, start), timestamp_us=t_us)


def in_process(
    generator: Any,
    renderer: pskel.Renderer,
    log: pskel.Log,
    request: video_model_pb2.SessionRequest,
    chunks: Sequence[video_model_pb2.VideoChunkRequest],
    cameras: Sequence[pskel.Camera],
    references: Pictures,
) -> Pictures:
    """The images ``[T, V, h, w, 3]`` of a generator for the poses of requests about a log; actors are the log's."""
    start, at0 = origin(log), log.at(log.times_us[0])

    def scene(t_us: int, ego: Array, actors: Sequence[pskel.Actor]) -> pskel.Scene:
        return pskel.Scene(ego, cameras, actors, name=str(t_us), t_us=t_us, map_of=at0)

    first_us = chunks[0].rig_trajectory.poses[0].timestamp_us
    before = log.at(round(first_us - 1e6 / 30))
    for number in range(generator.references):
        t_us = round(before.t_us - (generator.references - 1 - number) * 1e6 / 30)
        generator.add_reference(renderer, scene(t_us, before.ego, before.actors), references)
    made = []
    known: dict[str, pskel.Actor] = {}
    for asked in chunks:
        paths = []
        for path in asked.dynamic_state.actors:
            found = _track(log, path, start)
            paths.append((known.setdefault(found.track, found), path.trajectory.poses))
        scenes = []
        for at in asked.rig_trajectory.poses:
            boxes = [
                pskel.Actor(actor.track, actor.category, actor.size, poses.matrix(one.pose, start))
                for actor, path in paths
                for one in path
                if one.timestamp_us == at.timestamp_us
            ]
            scenes.append(scene(at.timestamp_us, poses.matrix(at.pose, start), boxes))
        for number, one in enumerate(scenes):
            made.append(generator.step(renderer, one, scenes[number + 1 : number + 1 + generator.forecasts]))
    return np.stack(made)


def _track(log: pskel.Log, path: video_model_pb2.DynamicActor, start: Array) -> pskel.Actor:
    """The actor of a log that is where an actor of a request is."""
    for at in path.trajectory.poses:
        position = poses.matrix(at.pose, start)[:3, 3]
        for actor in log.at(at.timestamp_us).actors:
            if np.linalg.norm(position - actor.global_from_box[:3, 3]) < 5e-3:
                return actor
    raise AssertionError("an actor that the log does not have")


def pictures(answers: Sequence[video_model_pb2.VideoChunkReturn], field: str = "rgb_frames") -> Pictures:
    """The images of chunks ``[T, V, H, W, 3]``."""
    return np.stack(
        [
            np.stack(frames)
            for answer in answers
            for frames in zip(
                *([decoded(image.data) for image in getattr(output, field)] for output in answer.camera_outputs), strict=True
            )
        ]
    )


def wait(condition: Any, seconds: float = 20.0) -> None:
    """Wait until a condition holds; fails after some seconds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


FAKES = [str(Path(__file__).parent / "world_fakes.py")]
