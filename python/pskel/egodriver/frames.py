"""Frames: between the global frame of a log and the messages of a driver."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pskel import _planner
from pskel.alpasim import common_pb2
from pskel.alpasim.poses import Matrix

from .driver import DriverError

#: Largest number of poses in a plan.
MAX_POSES = 10_000


def route(path: list[list[float]], global_from_rig: Matrix) -> list[common_pb2.Vec3]:
    """Return a path of global points ``[[x, y], ..]`` in the rig frame, meters.

    A path has no heights. The points are in the rig's xy plane, which is tilted on slopes, vertically above or below the path.
    """
    if not path:
        return []
    moved = np.array(path, dtype=np.float64) - global_from_rig[:2, 3]
    along, left = np.linalg.solve(global_from_rig[:2, :2], moved.T)
    return [common_pb2.Vec3(x=x, y=y) for x, y in zip(along.tolist(), left.tolist(), strict=True)]


def plan(
    trajectory: common_pb2.Trajectory, start: tuple[float, float], origin: Matrix, now_us: int, query_us: int
) -> list[dict[str, Any]]:
    """Convert a trajectory of poses local->rig to the waypoints after ``now_us``.

    ``start`` is the ego at ``now_us`` (global meters), ``origin`` the origin of the local frame (``[3]``, global meters). Raises
    ``DriverError`` for a trajectory that is empty, too short, too long, not finite or out of order.
    """
    count = len(trajectory.poses)
    if count > MAX_POSES:
        raise DriverError(f"expected a trajectory of at most {MAX_POSES} poses, found {count}")
    points: list[tuple[int, float, float, float]] = []
    last_us = -1
    for index, at in enumerate(trajectory.poses):
        if at.timestamp_us <= last_us:
            raise DriverError(
                f"expected a trajectory with rising times, found {at.timestamp_us} us after {last_us} us at pose {index}"
            )
        last_us = at.timestamp_us
        if last_us > now_us:  # earlier poses repeat the past
            points.append((last_us, *_placed(at.pose, origin, index)))
    if last_us < query_us:
        found = "none" if count == 0 else f"one of {(last_us - now_us) / 1e6:g} s"
        raise DriverError(f"expected a trajectory of at least {(query_us - now_us) / 1e6:g} s, found {found}")
    return _planner.waypoints(start, [((t_us - now_us) / 1e6, x, y, heading) for t_us, x, y, heading in points])


def _placed(pose: common_pb2.Pose, origin: Matrix, index: int) -> tuple[float, float, float]:
    """Global position and heading of pose ``index`` in a plan."""
    x, y, z, q = pose.vec.x, pose.vec.y, pose.vec.z, pose.quat
    norm = math.sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z)
    if not all(map(math.isfinite, (x, y, z, norm))) or not 0.9 < norm < 1.1:
        found = f"({x:g}, {y:g}, {z:g}) and ({q.w:g}, {q.x:g}, {q.y:g}, {q.z:g})"
        raise DriverError(f"expected finite positions and unit quaternions, found {found} at pose {index}")
    heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)
    return x + float(origin[0]), y + float(origin[1]), heading
