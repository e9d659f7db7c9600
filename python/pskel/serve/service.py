"""The service ``nre.grpc.protos.sensorsim.SensorsimService``: requests to answers and statuses."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import grpc
import numpy as np
from numpy.typing import NDArray

import pskel
from pskel.alpasim import common_pb2, poses, sensorsim_pb2, sensorsim_pb2_grpc, video_model_pb2_grpc
from pskel.alpasim.pinhole import pinhole
from pskel.alpasim.poses import Matrix

from . import cameras, images, lidar, pairs
from .cameras import MAX_PIXELS, Projection
from .errors import RequestError, answered, invalid, unknown
from .messages import MAX_MESSAGE, sized, version
from .scenes import RigCamera, Scene, Scenes
from .world import WorldModel

Request = sensorsim_pb2.RGBRenderRequest
#: Largest number of images in a request.
MAX_IMAGES = 256
#: Time for the calls in progress when the server stops, seconds.
GRACE_S = 5.0
#: Largest number of LiDAR sweeps in a request.
MAX_SWEEPS = 8


@dataclass(frozen=True)
class Shot:
    """A checked request: the scene with its ego and actors, and the camera with its pose ``global_from_camera``."""

    scene: Scene
    ego: Matrix
    actors: tuple[pskel.Actor, ...]
    #: Requests with the same key show the same instant with images of one size, and are rendered together.
    key: tuple[Any, ...]
    projection: Projection
    pose: Matrix
    image_format: int
    quality: float


#: Actors of the requests of a call, by scene, time and messages of their tracks.
Known = dict[tuple[str, int, tuple[bytes, ...]], tuple[pskel.Actor, ...]]


class Service(sensorsim_pb2_grpc.SensorsimServiceServicer):
    """Answers requests about scenes; ``fill`` fills the holes of images."""

    def __init__(self, scenes: Scenes, fill: bool) -> None:
        self._scenes = scenes
        self._fill = fill
        self._pool = ThreadPoolExecutor(os.cpu_count())  # encodes images

    def get_version(self, request: common_pb2.Empty, context: Any) -> common_pb2.VersionId:
        return version()

    def get_available_scenes(self, request: common_pb2.Empty, context: Any) -> common_pb2.AvailableScenesReturn:
        return common_pb2.AvailableScenesReturn(scene_ids=self._scenes.names)

    def get_loaded_scenes(self, request: common_pb2.Empty, context: Any) -> sensorsim_pb2.LoadedScenesReturn:
        loaded = [
            sensorsim_pb2.LoadedSceneEntry(scene_id=name, loaded_instance_count=1, reusable_instance_count=1)
            for name in self._scenes.loaded
        ]
        return sensorsim_pb2.LoadedScenesReturn(scenes=loaded, loaded_instance_capacity=self._scenes.capacity)

    def get_available_cameras(
        self, request: sensorsim_pb2.AvailableCamerasRequest, context: Any
    ) -> sensorsim_pb2.AvailableCamerasReturn:
        def answer() -> sensorsim_pb2.AvailableCamerasReturn:
            scene = self._scenes.get(request.scene_id)
            made = [_described(name, camera) for name, camera in scene.cameras.items()]
            return sensorsim_pb2.AvailableCamerasReturn(available_cameras=made)

        return answered(context, answer)

    def get_available_trajectories(
        self, request: sensorsim_pb2.AvailableTrajectoriesRequest, context: Any
    ) -> sensorsim_pb2.AvailableTrajectoriesReturn:
        def answer() -> sensorsim_pb2.AvailableTrajectoriesReturn:
            scene = self._scenes.get(request.scene_id)
            at = [
                common_pb2.PoseAtTime(pose=poses.pose(ego, scene.origin), timestamp_us=t_us) for t_us, ego in scene.trajectory
            ]
            kind = sensorsim_pb2.AvailableTrajectoriesReturn.AvailableTrajectory
            return sensorsim_pb2.AvailableTrajectoriesReturn(
                available_trajectories=[kind(trajectory=common_pb2.Trajectory(poses=at))]
            )

        return answered(context, answer)

    def get_available_ego_masks(self, request: common_pb2.Empty, context: Any) -> sensorsim_pb2.AvailableEgoMasksReturn:
        return sensorsim_pb2.AvailableEgoMasksReturn()

    def render_rgb(self, request: Request, context: Any) -> sensorsim_pb2.RGBRenderReturn:
        return answered(context, lambda: self._all([request], context)[0])

    def render_aggregated(
        self, request: sensorsim_pb2.AggregatedRenderRequest, context: Any
    ) -> sensorsim_pb2.AggregatedRenderReturn:
        def answer() -> sensorsim_pb2.AggregatedRenderReturn:
            if len(request.lidar_requests) > MAX_SWEEPS:
                text = f"expected at most {MAX_SWEEPS} lidar_requests, found {len(request.lidar_requests)}"
                raise RequestError(grpc.StatusCode.RESOURCE_EXHAUSTED, text)
            swept = [lidar.swept(self._scenes, each) for each in request.lidar_requests]
            made = self._all(request.rgb_requests, context)
            return sized(sensorsim_pb2.AggregatedRenderReturn(rgb_returns=made, lidar_returns=swept))

        return answered(context, answer)

    def render_lidar(self, request: sensorsim_pb2.LidarRenderRequest, context: Any) -> sensorsim_pb2.LidarRenderReturn:
        return answered(context, lambda: lidar.swept(self._scenes, request))

    def batch_render_rgb(
        self, request: sensorsim_pb2.BatchRGBRenderRequest, context: Any
    ) -> sensorsim_pb2.BatchRGBRenderReturn:
        """Answers each item; one that cannot be rendered has an error message and does not prevent the others."""

        def answer() -> sensorsim_pb2.BatchRGBRenderReturn:
            names = [item.camera_name for item in request.items]
            if len(set(names)) < len(names):
                raise invalid("items with different camera_name", names)
            shots: dict[str, Shot] = {}
            errors: dict[str, str] = {}
            known: Known = {}
            for item in request.items:
                try:
                    shots[item.camera_name] = self._shot(item.request, known)
                except RequestError as error:
                    errors[item.camera_name] = f"{error.code.name}: {error}"
            made = dict(zip(shots, self._rendered(list(shots.values()), context), strict=True))
            kind = sensorsim_pb2.BatchRGBRenderReturnItem
            items = [
                kind(camera_name=name, result=made[name], success=True)
                if name in made
                else kind(camera_name=name, success=False, error_message=errors[name])
                for name in names
            ]
            return sized(sensorsim_pb2.BatchRGBRenderReturn(items=items))

        return answered(context, answer)

    def _all(self, requests: Sequence[Request], context: Any) -> list[sensorsim_pb2.RGBRenderReturn]:
        known: Known = {}
        return self._rendered([self._shot(request, known) for request in requests], context)

    def _shot(self, request: Request, known: Known) -> Shot:
        """Check a request; ``known`` has the actors of the requests before. Raises ``RequestError``."""
        scene = self._scenes.get(request.scene_id)
        images.check(request.image_format, request.image_quality)
        if request.insert_ego_mask:
            raise unknown("no ego mask, since there are none", repr(request.ego_mask_id.camera_logical_id))
        spec, rig = _spec(scene, request)
        size = (request.resolution_h or spec.resolution_h, request.resolution_w or spec.resolution_w)
        pose = _pose("sensor_pose", request.sensor_pose, scene.origin)
        if request.HasField("ego_pose"):
            ego = _pose("ego_pose", request.ego_pose, scene.origin)
        else:
            ego = pose if rig is None else pose @ np.linalg.inv(rig.ego_from_camera)
        t_us = (request.frame_start_us + request.frame_end_us) // 2
        tracks = tuple(item.SerializeToString(deterministic=True) for item in request.dynamic_objects)
        instant = (request.scene_id, t_us, tracks)
        if instant not in known:
            known[instant] = _actors(scene, request, t_us)
        projection = cameras.projection(spec, size)
        # Cameras of one instant are rendered together only if their ego is known to be the same.
        key = (instant, ego.tobytes(), projection.size)
        return Shot(scene, ego, known[instant], key, projection, pose, request.image_format, request.image_quality)

    def _rendered(self, shots: Sequence[Shot], context: Any) -> list[sensorsim_pb2.RGBRenderReturn]:
        """Render in the order of the shots; shots of one instant are rendered together."""
        pixels = sum(shot.projection.size[0] * shot.projection.size[1] for shot in shots)
        if len(shots) > MAX_IMAGES or pixels > MAX_PIXELS:
            text = f"expected at most {MAX_IMAGES} images and {MAX_PIXELS} pixels in a request, found {len(shots)} and {pixels}"
            raise RequestError(grpc.StatusCode.RESOURCE_EXHAUSTED, text)
        groups: dict[tuple[Any, ...], list[int]] = {}
        for index, shot in enumerate(shots):
            groups.setdefault(shot.key, []).append(index)
        made: dict[int, sensorsim_pb2.RGBRenderReturn] = {}
        for group in groups.values():
            if not context.is_active():
                raise RequestError(grpc.StatusCode.CANCELLED, "expected a caller that waits, found none")
            first = shots[group[0]]
            views = [(shots[index].projection, shots[index].pose) for index in group]
            maps = first.scene.render(first.ego, views, first.actors)
            color = pskel.fill_holes(maps["color"], maps["depth"]) if self._fill else maps["color"]
            for index, data in zip(group, self._pool.map(_encoded, [shots[index] for index in group], color), strict=True):
                made[index] = sensorsim_pb2.RGBRenderReturn(image_bytes=data)
        return [made[index] for index in range(len(shots))]


def _encoded(shot: Shot, image: NDArray[np.uint8]) -> bytes:
    return images.encoded(shot.projection.image(image), shot.image_format, shot.quality)


def _actors(scene: Scene, request: Request, t_us: int) -> tuple[pskel.Actor, ...]:
    """Return the tracks of a request at their poses. Raises ``RequestError``."""
    tracks = pairs.tracks(request.dynamic_objects, scene.origin)
    return tuple(scene.actor(track, t_us, poses.mean(start, end)) for track, (start, end) in tracks.items())


def _spec(scene: Scene, request: Request) -> tuple[sensorsim_pb2.CameraSpec, RigCamera | None]:
    """Return a request's camera (the log's own if it has no parameters) and the log's camera with its ID."""
    given = request.camera_intrinsics
    rig = scene.cameras.get(given.logical_id)
    if given.WhichOneof("camera_param"):
        return given, rig
    if rig is None:
        raise unknown(f"the parameters of a camera, or one of {', '.join(scene.cameras)}", repr(given.logical_id))
    return _described(given.logical_id, rig).intrinsics, rig


def _pose(name: str, pair: sensorsim_pb2.PosePair, origin: Matrix) -> Matrix:
    """Return the mean of the poses at start and end, global. Raises ``RequestError``."""
    return poses.mean(*pairs.both(name, pair, origin))


def _described(name: str, camera: RigCamera) -> sensorsim_pb2.AvailableCamerasReturn.AvailableCamera:
    return pinhole(name, camera.intrinsics, camera.size, camera.ego_from_camera)


def serve(service: Service, address: str, threads: int, world: WorldModel | None = None) -> tuple[grpc.Server, int]:
    """Start a server, also of a world model if there is one; returns it and its port. Raises ``OSError`` if the address cannot be used."""
    limits = [("grpc.max_send_message_length", MAX_MESSAGE), ("grpc.max_receive_message_length", MAX_MESSAGE)]
    server = grpc.server(ThreadPoolExecutor(threads), options=[*limits, ("grpc.so_reuseport", 0)])
    sensorsim_pb2_grpc.add_SensorsimServiceServicer_to_server(service, server)
    if world is not None:
        video_model_pb2_grpc.add_WorldModelServiceServicer_to_server(world, server)
    try:
        port = server.add_insecure_port(address)
    except RuntimeError:
        port = 0
    if port == 0:
        raise OSError(f"expected an address to listen on, found {address}, which is in use or not of this machine")
    server.start()
    return server, port
