"""Drivers for tests, served over gRPC on a free port; each fails in its own way from the second plan on."""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import grpc
from pskel.alpasim import common_pb2, egodriver_pb2, egodriver_pb2_grpc

Reply = egodriver_pb2.DriveResponse
STEP_US = 100_000


class FakeDriver(egodriver_pb2_grpc.EgodriverServiceServicer):
    """Plans 0.5 m along x every 0.1 s with heading 0, on coordinates that are exact in 32 bits.

    ``change`` replaces plans from the second on. ``calls`` has the names of all calls, ``requests`` their messages.
    """

    def __init__(self, change: Callable[["FakeDriver", Reply, Any], Reply] = lambda _, reply, __: reply) -> None:
        self.change = change
        self.calls: list[str] = []
        self.requests: list[Any] = []
        self.released = threading.Event()

    def _note(self, name: str, request: Any) -> None:
        self.calls.append(name)
        self.requests.append(request)

    def of(self, name: str) -> list[Any]:
        """All requests of a method."""
        return [request for call, request in zip(self.calls, self.requests, strict=True) if call == name]

    def get_version(self, request: common_pb2.Empty, context: Any) -> common_pb2.VersionId:
        self._note("get_version", request)
        return common_pb2.VersionId(version_id="fake", grpc_api_version={"minor": 54})

    def start_session(self, request: egodriver_pb2.DriveSessionRequest, context: Any) -> common_pb2.SessionRequestStatus:
        self._note("start_session", request)
        return common_pb2.SessionRequestStatus()

    def close_session(self, request: egodriver_pb2.DriveSessionCloseRequest, context: Any) -> common_pb2.Empty:
        self._note("close_session", request)
        return common_pb2.Empty()

    def submit_image_observation(self, request: egodriver_pb2.RolloutCameraImage, context: Any) -> common_pb2.Empty:
        self._note("submit_image_observation", request)
        return common_pb2.Empty()

    def submit_egomotion_observation(self, request: egodriver_pb2.RolloutEgoTrajectory, context: Any) -> common_pb2.Empty:
        self._note("submit_egomotion_observation", request)
        return common_pb2.Empty()

    def submit_route(self, request: egodriver_pb2.RouteRequest, context: Any) -> common_pb2.Empty:
        self._note("submit_route", request)
        return common_pb2.Empty()

    def drive(self, request: egodriver_pb2.DriveRequest, context: Any) -> Reply:
        self._note("drive", request)
        ego = self.of("submit_egomotion_observation")[-1].trajectory.poses[-1]
        reply = Reply()
        reply.trajectory.poses.append(ego)
        x, y = round(ego.pose.vec.x * 8) / 8, round(ego.pose.vec.y * 8) / 8
        for i in range(1, 9):
            pose = common_pb2.Pose(vec={"x": x + 0.5 * i, "y": y}, quat={"w": 1.0})
            reply.trajectory.poses.add(pose=pose, timestamp_us=request.time_now_us + i * STEP_US)
        return reply if self.calls.count("drive") < 2 else self.change(self, reply, context)


def _hang(driver: FakeDriver, reply: Reply, _: Any) -> Reply:
    driver.released.wait(30.0)
    return reply


def _not_finite(_: FakeDriver, reply: Reply, __: Any) -> Reply:
    reply.trajectory.poses[3].pose.vec.x = float("nan")
    return reply


def _without_quaternion(_: FakeDriver, reply: Reply, __: Any) -> Reply:
    reply.trajectory.poses[2].pose.ClearField("quat")
    return reply


def _empty(_: FakeDriver, __: Reply, ___: Any) -> Reply:
    return Reply()


def _short(_: FakeDriver, reply: Reply, __: Any) -> Reply:
    del reply.trajectory.poses[2:]
    return reply


def _backwards(_: FakeDriver, reply: Reply, __: Any) -> Reply:
    reply.trajectory.poses[4].timestamp_us -= 2 * STEP_US
    return reply


def _other_session(driver: FakeDriver, reply: Reply, context: Any) -> Reply:
    context.abort(grpc.StatusCode.NOT_FOUND, f"Unknown session {driver.of('drive')[-1].session_uuid}\nline 2")
    return reply


def _poses(_: FakeDriver, reply: Reply, __: Any) -> Reply:
    last = reply.trajectory.poses[-1]
    for i in range(1, 10_001):
        reply.trajectory.poses.add(pose=last.pose, timestamp_us=last.timestamp_us + i)
    return reply


def _bytes(_: FakeDriver, reply: Reply, __: Any) -> Reply:
    reply.debug_info.unstructured_debug_info = bytes(65 << 20)
    return reply


def _terminate(_: FakeDriver, reply: Reply, __: Any) -> Reply:
    reply.terminate_session = True
    return reply


def _raise(_: FakeDriver, __: Reply, ___: Any) -> Reply:
    raise RuntimeError("no checkpoint")


def _die(_: FakeDriver, __: Reply, ___: Any) -> Reply:
    os._exit(1)


CHANGES: dict[str, Callable[[FakeDriver, Reply, Any], Reply]] = {
    "hangs": _hang,
    "not finite": _not_finite,
    "without quaternion": _without_quaternion,
    "empty": _empty,
    "short": _short,
    "backwards": _backwards,
    "other session": _other_session,
    "poses": _poses,
    "bytes": _bytes,
    "terminates": _terminate,
    "raises": _raise,
    "dies": _die,
}


@contextmanager
def served(driver: FakeDriver) -> Iterator[str]:
    """Serve a driver; yields its address."""
    limits = [("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1)]
    server = grpc.server(ThreadPoolExecutor(8), options=limits)
    egodriver_pb2_grpc.add_EgodriverServiceServicer_to_server(driver, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        yield f"127.0.0.1:{port}"
    finally:
        driver.released.set()
        server.stop(None).wait()


if __name__ == "__main__":
    with served(FakeDriver(CHANGES[sys.argv[1]])) as address:
        print(address, flush=True)
        time.sleep(300)
