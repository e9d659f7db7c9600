"""Frames: between the global frame of a log and the messages of a driver."""

from __future__ import annotations

import math
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from pskel.alpasim import common_pb2

from .driver import DriverError

Matrix = NDArray[np.float64]

#: Largest number of poses of a plan.
MAX_POSES = 10_000


class Waypoint(TypedDict):
    """Waypoint of a plan (docs/PLANNER.md): seconds after the observation, global meters, radians, m/s."""

    t: float
    x: float
    y: float
    heading: float
    v: float


def pose(matrix: Matrix, origin: Matrix | None = None) -> common_pb2.Pose:
    """Return the pose of a rigid matrix ``[4, 4]``, with ``origin`` (``[3]``, meters) subtracted from its translation."""
    x, y, z = matrix[:3, 3] if origin is None else matrix[:3, 3] - origin
    qw, qx, qy, qz = quaternion(matrix[:3, :3])
    return common_pb2.Pose(vec=common_pb2.Vec3(x=x, y=y, z=z), quat=common_pb2.Quat(w=qw, x=qx, y=qy, z=qz))


def quaternion(rotation: Matrix) -> tuple[float, float, float, float]:
    """Return the unit quaternion w, x, y, z (w at least 0) of a rotation ``[3, 3]``."""
    # K's eigenvector of the largest eigenvalue is the quaternion, for all angles (Bar-Itzhack, 2000).
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    k = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    _, vectors = np.linalg.eigh(k)
    w, x, y, z = (vectors[:, -1] * (-1.0 if vectors[0, -1] < 0.0 else 1.0)).tolist()
    return w, x, y, z


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
) -> list[Waypoint]:
    """Return the waypoints after ``now_us`` of a trajectory of poses local->rig.

    ``start`` is the ego at ``now_us`` (global meters), ``origin`` the origin of the local frame (``[3]``, global meters). A message
    has no speeds: that of a waypoint is the mean between its neighbors, along its heading, that of the last one since the waypoint
    before. Raises ``DriverError`` for a trajectory that is empty, too short, too long, not finite or out of order.
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
    waypoints: list[Waypoint] = []
    known = [(now_us, *start), *((t_us, x, y) for t_us, x, y, _ in points)]
    for index, (t_us, x, y, heading) in enumerate(points):
        (t0, x0, y0), (t1, x1, y1) = known[index], known[min(index + 2, len(points))]
        along = (x1 - x0) * math.cos(heading) + (y1 - y0) * math.sin(heading)
        waypoints.append({"t": (t_us - now_us) / 1e6, "x": x, "y": y, "heading": heading, "v": along / (t1 - t0) * 1e6})
    return waypoints


def _placed(pose: common_pb2.Pose, origin: Matrix, index: int) -> tuple[float, float, float]:
    """Global position and heading of a pose of a plan."""
    x, y, z, q = pose.vec.x, pose.vec.y, pose.vec.z, pose.quat
    norm = math.sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z)
    if not all(map(math.isfinite, (x, y, z, norm))) or not 0.9 < norm < 1.1:
        found = f"({x:g}, {y:g}, {z:g}) and ({q.w:g}, {q.x:g}, {q.y:g}, {q.z:g})"
        raise DriverError(f"expected finite positions and unit quaternions, found {found} at pose {index}")
    heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)
    return x + float(origin[0]), y + float(origin[1]), heading
