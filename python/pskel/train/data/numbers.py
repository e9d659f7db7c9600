"""Camera and motion numbers of the denoiser protocol, in NumPy."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["CAMERA_NUMBERS", "camera_numbers", "ego_motion", "interpolated", "joined", "moved_by", "pose_at"]

Array = npt.NDArray[Any]

CAMERA_NUMBERS = 16


def camera_numbers(ego_from_camera: Array, intrinsics: Array, sizes: Array) -> npt.NDArray[np.float32]:
    """Return ``float32 [V, 16]``: the upper three rows of ``ego_from_camera``, then fx/W, fy/H, cx/W, cy/H.

    ``ego_from_camera`` is ``[V, 4, 4]`` in meters, ``intrinsics`` ``[V, 3, 3]`` in pixels of ``sizes`` ``[V, 2]``
    (height, width).
    """
    height, width = np.asarray(sizes, np.float64).reshape(-1, 2).T
    k = np.asarray(intrinsics, np.float64)
    fractions = np.stack([k[:, 0, 0] / width, k[:, 1, 1] / height, k[:, 0, 2] / width, k[:, 1, 2] / height], axis=1)
    rows = np.asarray(ego_from_camera, np.float64)[:, :3].reshape(-1, 12)
    return np.concatenate([rows, fractions], axis=1).astype(np.float32)


def ego_motion(before: Array | None, after: Array) -> npt.NDArray[np.float32]:
    """Return the motion from one ego pose to the next, ``float32 [3]``: forward and left (m) in the ego frame before,
    yaw (rad).

    Poses are ``global_from_ego`` ``[4, 4]``. Without a pose before, the motion is zero.
    """
    if before is None:
        return np.zeros(3, np.float32)
    moved = np.linalg.inv(np.asarray(before, np.float64)) @ np.asarray(after, np.float64)
    return np.array([moved[0, 3], moved[1, 3], math.atan2(moved[1, 0], moved[0, 0])], np.float32)


def joined(first: npt.ArrayLike, second: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Return the motion of two motions ``[3]`` in a row, in the plane."""
    forward, left, yaw = (float(x) for x in np.asarray(first))
    c, s = math.cos(yaw), math.sin(yaw)
    ahead, aside, turn = (float(x) for x in np.asarray(second))
    return np.array([forward + c * ahead - s * aside, left + s * ahead + c * aside, yaw + turn], np.float32)


def moved_by(pose: npt.ArrayLike, motion: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the pose ``[4, 4]`` after a motion ``[3]`` in the plane of the ego."""
    forward, left, yaw = (float(x) for x in np.asarray(motion))
    c, s = math.cos(yaw), math.sin(yaw)
    step = np.array([[c, -s, 0, forward], [s, c, 0, left], [0, 0, 1, 0], [0, 0, 0, 1]])
    moved: npt.NDArray[np.float64] = np.asarray(pose, np.float64) @ step
    return moved


def interpolated(first: Array, second: Array, share: float) -> npt.NDArray[np.float64]:
    """Return the pose ``[4, 4]`` at a share of the way between two poses; a share outside of 0 to 1 extrapolates."""
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    turn = a[:3, :3].T @ b[:3, :3]
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = float(np.linalg.norm(axis)) / 2
    angle = math.atan2(sine, (float(np.trace(turn)) - 1) / 2) * share
    result = np.eye(4)
    result[:3, 3] = a[:3, 3] + share * (b[:3, 3] - a[:3, 3])
    result[:3, :3] = a[:3, :3]
    if sine > 1e-12:  # Rodrigues' formula
        x, y, z = axis / (2 * sine)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        result[:3, :3] @= np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
    return result


def pose_at(t_us: int, known: Mapping[int, Array]) -> npt.NDArray[np.float64]:
    """Return the pose ``[4, 4]`` at a time, from poses at other times (microseconds), at least one."""
    if t_us in known or len(known) == 1:
        return np.asarray(known.get(t_us, next(iter(known.values()))), np.float64)
    times = sorted(known)
    after = min(max(bisect_right(times, t_us), 1), len(times) - 1)
    first, second = times[after - 1], times[after]
    return interpolated(known[first], known[second], (t_us - first) / (second - first))
