"""Poses in messages, which have 32-bit floats: of a local frame whose origin is near the scene."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pskel.alpasim import common_pb2

Matrix = NDArray[np.float64]


def local_origin(position: Matrix) -> Matrix:
    """Return the origin of the local frame, global meters ``[3]``: a position, rounded down, so that the same log has the same."""
    return np.floor(position)


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


def matrix(pose: common_pb2.Pose, origin: Matrix | None = None) -> Matrix:
    """Return the rigid matrix ``[4, 4]`` of a pose, with ``origin`` (``[3]``, meters) added to its translation.

    Raises ``ValueError`` for numbers that are not finite, and quaternions that are not of unit length.
    """
    vec, q = pose.vec, pose.quat
    position, quat = np.array([vec.x, vec.y, vec.z]), np.array([q.w, q.x, q.y, q.z])
    norm = math.sqrt(float(quat @ quat)) if np.isfinite(quat).all() else math.nan
    if not np.isfinite(position).all() or not 0.9 < norm < 1.1:
        raise ValueError(f"expected finite positions and unit quaternions, found {position.tolist()} and {quat.tolist()}")
    result = np.eye(4)
    result[:3, :3] = rotation(quat / norm)
    result[:3, 3] = position if origin is None else position + origin
    return result


def rotation(quaternion: Matrix) -> Matrix:
    """Return the rotation ``[3, 3]`` of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def mean(start: Matrix, end: Matrix) -> Matrix:
    """Return the pose half way between two rigid matrices ``[4, 4]``: the mean position and rotation."""
    if np.array_equal(start, end):
        return start
    a, b = np.array(quaternion(start[:3, :3])), np.array(quaternion(end[:3, :3]))
    half = a + (b if a @ b >= 0.0 else -b)
    result = np.eye(4)
    result[:3, :3] = rotation(half / np.linalg.norm(half))
    result[:3, 3] = (start[:3, 3] + end[:3, 3]) / 2.0
    return result
