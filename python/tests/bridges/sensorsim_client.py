"""A client of the renderer service, written from the protos, and logs whose poses are exact in 32 bits."""

import io
import json
import select
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pskel
from numpy.typing import NDArray
from PIL import Image
from pskel.alpasim import poses, sensorsim_pb2, sensorsim_pb2_grpc

Request = sensorsim_pb2.RGBRenderRequest


def exact_town(folder: Path, seed: int, frames: int = 6, size: str = "113x200") -> tuple[str, Path]:
    """Write a town in the format of nuScenes and its skeleton; returns its name and the skeleton.

    Then round all poses so that messages hold them exactly: the ego's have no rotation, positions are
    multiples of 1/1024 m, and quaternions are 32-bit numbers of unit length. The pictures then show other
    places, but the same for every program.
    """
    data = folder / f"town{seed}"
    run("town", f"seed={seed},frames={frames},size={size}", f"--out={data}")
    name = f"nuscenes:{data}@v1.0-town"
    run("build", name, f"--out={folder / f'skeleton{seed}'}")
    for table in ("ego_pose", "calibrated_sensor", "sample_annotation"):
        path = data / "v1.0-town" / f"{table}.json"
        rows = json.loads(path.read_text())
        for row in rows:
            row["translation"] = [round(value * 1024) / 1024 for value in row["translation"]]
            row["rotation"] = [1.0, 0.0, 0.0, 0.0] if table == "ego_pose" else _exact(row["rotation"])
        path.write_text(json.dumps(rows))
    return name, folder / f"skeleton{seed}"


def _exact(rotation: Sequence[float]) -> list[float]:
    """Return a 32-bit quaternion near another that stays itself when it is normalized and rounded."""
    now = np.array(rotation)
    for _ in range(100):
        before, now = now, (now / np.linalg.norm(now)).astype(np.float32).astype(np.float64)
        if np.array_equal(before, now):
            return [float(value) for value in now]
    raise AssertionError(f"no exact quaternion near {rotation}")


def run(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "-m", "pskel", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@contextmanager
def server(*arguments: str) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """A server in a process of its own; yields it and its address."""
    command = [sys.executable, "-m", "pskel.serve", *arguments]
    if not any(argument.startswith("--port") for argument in arguments):
        command.append("--port=0")
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        ready, _, _ = select.select([process.stdout], [], [], 120.0)
        line = process.stdout.readline() if ready else ""
        assert line.startswith("pskel.serve: "), process.stderr.read() if process.stderr else ""
        yield process, line.split()[1].removesuffix(":")
    finally:
        process.kill()
        process.communicate()


def stub(address: str) -> sensorsim_pb2_grpc.SensorsimServiceStub:
    limits = [("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1)]
    return sensorsim_pb2_grpc.SensorsimServiceStub(grpc.insecure_channel(address, options=limits))


def requests(log: pskel.Log, scene: pskel.Scene, available: Any) -> dict[str, Request]:
    """The request of each camera for a scene of a log, with all its actors, as a PNG."""
    origin = poses.local_origin(log.at(log.times_us[0]).ego[:3, 3])
    specs = {camera.logical_id: camera.intrinsics for camera in available.available_cameras}
    objects = []
    for actor in scene.actors:
        box = poses.pose(actor.global_from_box, origin)
        objects.append(sensorsim_pb2.DynamicObject(track_id=actor.track, pose_pair={"start_pose": box, "end_pose": box}))
    ego = poses.pose(scene.ego, origin)
    made = {}
    for name, camera_from_global in zip(scene.cameras, scene.camera_from_global, strict=True):
        at = poses.pose(np.linalg.inv(camera_from_global), origin)
        made[name] = Request(
            scene_id=log.name,
            resolution_h=specs[name].resolution_h,
            resolution_w=specs[name].resolution_w,
            camera_intrinsics=specs[name],
            frame_start_us=scene.t_us,
            frame_end_us=scene.t_us,
            sensor_pose={"start_pose": at, "end_pose": at},
            ego_pose={"start_pose": ego, "end_pose": ego},
            dynamic_objects=objects,
            image_format=sensorsim_pb2.PNG,
        )
    return made


def batch(items: dict[str, Request]) -> sensorsim_pb2.BatchRGBRenderRequest:
    kind = sensorsim_pb2.BatchRGBRenderRequestItem
    return sensorsim_pb2.BatchRGBRenderRequest(items=[kind(camera_name=n, request=r) for n, r in items.items()])


def decoded(data: bytes) -> NDArray[np.uint8]:
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB"))
