"""Camera and motion numbers of each frame and camera: ``added_time_ids`` of the network."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["NO_STEERING", "WHEELBASE_M", "STEERING_RATIO", "added_time_ids", "ids_from_motion"]

NO_STEERING = -1000.0
"""Steering of an ego that stands."""
WHEELBASE_M = 2.7
STEERING_RATIO = 14.0
"""Angle of the steering wheel over that of the wheels."""

DROPPED_MOTION = -1000.0
"""Each number of a dropped motion, as input and as speed and steering."""

_MIN_DISTANCE_M = 0.01
_POSE_ELEMENTS = (2, 6, 10, 3, 7, 11)  # optical axis and position, of a row-major 4x4 matrix


def added_time_ids(
    intrinsics: Tensor,
    image_sizes: Tensor,
    ego_from_camera: Tensor,
    global_from_ego: Tensor,
    fps: float,
    *,
    with_fps: bool = True,
) -> Tensor:
    """Return the numbers ``float32 [B, T, V, 13]`` of B clips of T frames and V cameras; 12 without the leading fps.

    They are: frames per second; fx/H, fy/H, cx/W, cy/H of the original images; optical axis and position (m) of the camera
    in the ego frame; speed (km/h); angle of the steering wheel (rad, left is positive).

    - ``intrinsics`` ``[B, T, V, 3, 3]`` in pixels, for images with ``image_sizes`` ``[B, T, V, 2]`` (width,
      height),
    - ``ego_from_camera`` ``[B, T, V, 4, 4]``; the camera frame is x right, y down, z forward,
    - ``global_from_ego`` ``[B, T, V, 4, 4]``, or ``[B, T, 1, 4, 4]`` for one ego pose per frame; best in ``float64``.

    Steering is -1000 where the ego moved by at most 0.01 m since the previous frame. The first frame has the motion of the
    second, so T is at least 2 (``ValueError``).
    """
    if global_from_ego.shape[1] < 2:
        raise ValueError(f"expected at least 2 frames for the motion of the ego, found {global_from_ego.shape[1]}")
    camera = _camera(intrinsics.double(), image_sizes.double(), ego_from_camera.double())
    action = _action(global_from_ego.double(), fps).expand(*camera.shape[:3], 2)
    rate = camera.new_full((*camera.shape[:3], 1), fps)
    return torch.cat([rate, camera, action] if with_fps else [camera, action], dim=-1).float()


def ids_from_motion(cameras: Tensor, image_sizes: Tensor, action: Tensor, fps: float) -> Tensor:
    """Return the numbers of ``added_time_ids``, ``float32 [T, V, 13]``, from the inputs of the denoiser protocol.

    - ``cameras`` ``[T, V, 16]``: upper three rows of ``ego_from_camera``, then focal lengths and principal point as fractions
      of width and height,
    - ``image_sizes`` ``[V, 2]`` (width, height) of the original images in pixels,
    - ``action`` ``[T, 3]``: motion since the previous frame, forward and left (m), yaw (rad). Speed and steering are -1000
      where it is dropped, that is -1000.

    The first frame has the motion of the second, so T is at least 2 (``ValueError``).
    """
    if len(action) < 2:
        raise ValueError(f"expected at least 2 frames for the motion of the ego, found {len(action)}")
    cameras, action, sizes = cameras.double(), action.double(), image_sizes.double()
    axis_and_position = cameras[..., list(_POSE_ELEMENTS)]
    fractions = cameras[..., 12:]
    normalized = torch.cat([fractions[..., :1] * (sizes[:, :1] / sizes[:, 1:]), fractions[..., 1:]], dim=-1)
    distance, yaw = action[:, :2].norm(dim=-1), action[:, 2]
    motion = torch.stack([distance * fps * 3.6, _steering(distance, yaw)], dim=-1)
    motion = torch.where((action == DROPPED_MOTION).all(-1, keepdim=True), DROPPED_MOTION, motion)
    motion = torch.cat([motion[1:2], motion[1:]])[:, None].expand(*cameras.shape[:2], 2)
    rate = cameras.new_full((*cameras.shape[:2], 1), fps)
    return torch.cat([rate, normalized, axis_and_position, motion], dim=-1).float()


def _camera(intrinsics: Tensor, sizes: Tensor, ego_from_camera: Tensor) -> Tensor:
    """Normalized intrinsics, optical axis and position, ``[B, T, V, 10]``."""
    width, height = sizes[..., 0], sizes[..., 1]
    scaled = [
        intrinsics[..., 0, 0] / height,
        intrinsics[..., 1, 1] / height,
        intrinsics[..., 0, 2] / width,
        intrinsics[..., 1, 2] / height,
    ]
    return torch.cat([torch.stack(scaled, dim=-1), ego_from_camera.flatten(-2)[..., _POSE_ELEMENTS]], dim=-1)


def _action(global_from_ego: Tensor, fps: float) -> Tensor:
    """Speed and steering since the previous frame, ``[B, T, V, 2]``."""
    motion = torch.linalg.inv(global_from_ego[:, :-1]) @ global_from_ego[:, 1:]
    distance = motion[..., :3, 3].norm(dim=-1)
    yaw = torch.atan2(motion[..., 1, 0], motion[..., 0, 0])
    action = torch.stack([distance * fps * 3.6, _steering(distance, yaw)], dim=-1)
    return torch.cat([action[:, :1], action], dim=1)


def _steering(distance: Tensor, yaw: Tensor) -> Tensor:
    return torch.where(distance > _MIN_DISTANCE_M, yaw / distance * WHEELBASE_M * STEERING_RATIO, NO_STEERING)
