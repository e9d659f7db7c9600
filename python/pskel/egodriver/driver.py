"""Client of a driving policy: one session of ``egodriver.EgodriverService``."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # failed connections are reported by the exceptions

import grpc

from pskel.alpasim import common_pb2, egodriver_pb2, egodriver_pb2_grpc, sensorsim_pb2

Answer = TypeVar("Answer")

#: Largest message in each direction, bytes; that of AlpaSim's runtime.
MAX_MESSAGE = 64 << 20
#: Declares optical camera frames to carla-driver-interface, which needs this in its mode ``carla``.
CONTRACT = (("carla-driver-interface-contract", "2"),)


class DriverError(Exception):
    """A driver that cannot be used, or files that a driver needs but a rollout lacks; one line."""


class Driver:
    """Connection to a driver at ``target``, a gRPC address such as ``HOST:PORT`` or ``unix:PATH``.

    All calls since the last ``start_clock`` share ``timeout_s`` seconds. They raise ``DriverError``.
    """

    def __init__(self, target: str, timeout_s: float) -> None:
        limits = [("grpc.max_send_message_length", MAX_MESSAGE), ("grpc.max_receive_message_length", MAX_MESSAGE)]
        self.target = target
        self.session = ""
        self._timeout_s = timeout_s
        self._channel = grpc.insecure_channel(target, options=[*limits, ("grpc.enable_http_proxy", 0)])
        self._stub = egodriver_pb2_grpc.EgodriverServiceStub(self._channel)
        self.start_clock()

    def start_clock(self) -> None:
        """Give the next calls, together, the whole time-out."""
        self._deadline = time.monotonic() + self._timeout_s

    def version(self) -> common_pb2.VersionId:
        """Return the version of the driver; waits for a driver that is not listening yet."""
        return self._call("get_version", self._stub.get_version, common_pb2.Empty(), wait_for_ready=True)

    def start(
        self, session: str, seed: int, scene: str, cameras: Sequence[sensorsim_pb2.AvailableCamerasReturn.AvailableCamera]
    ) -> None:
        """Start the session that all other calls belong to."""
        request = egodriver_pb2.DriveSessionRequest(session_uuid=session, random_seed=seed)
        request.debug_info.scene_id = scene
        request.rollout_spec.vehicle.available_cameras.extend(cameras)
        self.session = session
        self._call("start_session", self._stub.start_session, request, metadata=CONTRACT)

    def send_image(self, camera: str, t_us: int, image: bytes) -> None:
        """Send the image (PNG or JPEG) of a camera; all its pixels are of one time (microseconds)."""
        frame = egodriver_pb2.RolloutCameraImage.CameraImage(
            frame_start_us=t_us, frame_end_us=t_us, image_bytes=image, logical_id=camera
        )
        request = egodriver_pb2.RolloutCameraImage(session_uuid=self.session, camera_image=frame)
        self._call("submit_image_observation", self._stub.submit_image_observation, request)

    def send_motion(self, poses: Sequence[common_pb2.PoseAtTime], states: Sequence[common_pb2.DynamicState]) -> None:
        """Send poses local->rig in the order of their times, and for each its derivatives in the rig frame."""
        request = egodriver_pb2.RolloutEgoTrajectory(
            session_uuid=self.session, trajectory=common_pb2.Trajectory(poses=poses), dynamic_states=states
        )
        self._call("submit_egomotion_observation", self._stub.submit_egomotion_observation, request)

    def send_route(self, t_us: int, waypoints: Sequence[common_pb2.Vec3]) -> None:
        """Send the route ahead, in the rig frame at ``t_us`` (microseconds)."""
        route = egodriver_pb2.Route(timestamp_us=t_us, waypoints=waypoints)
        request = egodriver_pb2.RouteRequest(session_uuid=self.session, route=route)
        self._call("submit_route", self._stub.submit_route, request)

    def drive(self, now_us: int, query_us: int) -> egodriver_pb2.DriveResponse:
        """Return the plan at ``now_us``, which should reach ``query_us`` (microseconds)."""
        request = egodriver_pb2.DriveRequest(session_uuid=self.session, time_now_us=now_us, time_query_us=query_us)
        return self._call("drive", self._stub.drive, request)

    def close(self, timeout_s: float) -> bool:
        """Close the session, if one was started, and the connection. Returns ``False`` if the driver did not answer."""
        session, self.session = self.session, ""
        try:
            if session:
                request = egodriver_pb2.DriveSessionCloseRequest(session_uuid=session)
                self._stub.close_session(request, timeout=timeout_s)
        except grpc.RpcError:
            return False
        finally:
            self._channel.close()
        return True

    def _call(self, name: str, method: Callable[..., Answer], request: object, **options: Any) -> Answer:
        left_s = max(self._deadline - time.monotonic(), 1e-3)
        try:
            return method(request, timeout=left_s, **options)
        except grpc.RpcError as error:
            code, details = error.code(), error.details() or ""
        within, found = "", f"{code.name}: {one_line(details)}"
        if code is grpc.StatusCode.DEADLINE_EXCEEDED:
            within, found = f" within {self._timeout_s:g} s", "none"
        raise DriverError(f"driver {self.target}: expected an answer to {name}{within}, found {found}")


def one_line(text: str, limit: int = 300) -> str:
    """Text of a peer as one line of printable characters, shortened."""
    shown = "".join(char if char.isprintable() else " " for char in text[: limit + 1])
    return " ".join(shown[:limit].split()) + (".." if len(shown) > limit else "")
