"""Camera and motion numbers of the denoiser protocol, in NumPy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["CAMERA_NUMBERS", "camera_numbers", "ego_motion", "joined", "moved_by"]

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
