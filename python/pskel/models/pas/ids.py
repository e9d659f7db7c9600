"""Camera and motion numbers of each frame and camera: ``added_time_ids`` of the network."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from .._condition import DROPPED_MOTION
from .._rig import CAMERA_NUMBERS, CameraNumbers

__all__ = ["MOTION_IDS", "NO_STEERING", "STEERING_RATIO", "WHEELBASE_M", "added_time_ids", "ids_from_motion"]

NO_STEERING = -1000.0
"""Steering of an ego that stands."""
WHEELBASE_M = 2.7
STEERING_RATIO = 14.0
"""Angle of the steering wheel over that of the wheels."""

MOTION_IDS = 2
"""Speed and steering, the last of the numbers."""

_MIN_DISTANCE_M = 0.01
_POSE_ELEMENTS = (2, 6, 10, 3, 7, 11)  # optical axis and position, of a row-major 4x4 matrix


def added_time_ids(
    intrinsics: Tensor,
    image_sizes: Tensor,
    ego_from_camera: Tensor,
    global_from_ego: Tensor,
    fps: float | Tensor,
    *,
    with_fps: bool = True,
    camera_numbers: CameraNumbers = "fx,fy,cx,cy",
) -> Tensor:
    """Return the numbers ``float32 [B, T, V, 13]`` of B clips of T frames and V cameras; 12 without the leading fps.

    They are: frames per second; fx/H, fy/H, cx/W, cy/H of the original images; optical axis and position (m) of the camera
    in the ego frame; speed (km/h); angle of the steering wheel (rad, left is positive).

    - ``intrinsics`` ``[B, T, V, 3, 3]`` (or 4, 4) in pixels, for images with ``image_sizes`` ``[B, T, V, 2]`` (width,
      height),
    - ``ego_from_camera`` ``[B, T, V, 4, 4]``; the camera frame is x right, y down, z forward,
    - ``global_from_ego`` ``[B, T, V, 4, 4]``, or ``[B, T, 1, 4, 4]`` for one ego pose per frame; best in ``float64``,
    - ``fps``: frames per second, of all clips or ``[B]``,
    - ``camera_numbers``: the four numbers of the intrinsics, see ``CameraNumbers``.

    Steering is -1000 where the ego moved by at most 0.01 m since the previous frame. The first frame has the motion of the
    second, so T is at least 2 (``ValueError``).
    """
    if global_from_ego.shape[1] < 2:
        raise ValueError(f"expected at least 2 frames for the motion of the ego, found {global_from_ego.shape[1]}")
    camera = _camera(intrinsics.double(), image_sizes.double(), ego_from_camera.double(), camera_numbers)
    rates = torch.as_tensor(fps).double().expand(len(camera)).view(-1, 1, 1)
    action = _action(global_from_ego.double(), rates).expand(*camera.shape[:3], 2)
    rate = rates.unsqueeze(-1).expand(*camera.shape[:3], 1)
    return torch.cat([rate, camera, action] if with_fps else [camera, action], dim=-1).float()


def ids_from_motion(
    cameras: Tensor,
    image_sizes: Tensor,
    action: Tensor,
    fps: float,
    *,
    camera_numbers: CameraNumbers = "fx,fy,cx,cy",
) -> Tensor:
    """Return the numbers of ``added_time_ids``, ``float32 [T, V, 13]``, from the inputs of the denoiser protocol.

    - ``cameras`` ``[T, V, 16]``: upper three rows of ``ego_from_camera``, then focal lengths and principal point as fractions
      of width and height,
    - ``image_sizes`` ``[V, 2]`` (width, height) of the original images in pixels,
    - ``action`` ``[T, 3]``: motion since the previous frame, forward and left (m), yaw (rad). Speed and steering are -1000
      where it is dropped, that is -1000,
    - ``camera_numbers``: the four numbers of the intrinsics, see ``CameraNumbers``.

    The first frame has the motion of the second, so T is at least 2 (``ValueError``).
    """
    if len(action) < 2:
        raise ValueError(f"expected at least 2 frames for the motion of the ego, found {len(action)}")
    cameras, action, sizes = cameras.double(), action.double(), image_sizes.double()
    axis_and_position = cameras[..., list(_POSE_ELEMENTS)]
    focal_x, focal_y, center_x, center_y = cameras[..., 12:].unbind(-1)
    normalized = _normalized(focal_x * (sizes[:, 0] / sizes[:, 1]), focal_y, center_x, center_y, camera_numbers)
    distance, yaw = action[:, :2].norm(dim=-1), action[:, 2]
    motion = torch.stack([distance * fps * 3.6, _steering(distance, yaw)], dim=-1)
    motion = torch.where((action == DROPPED_MOTION).all(-1, keepdim=True), DROPPED_MOTION, motion)
    motion = torch.cat([motion[1:2], motion[1:]])[:, None].expand(*cameras.shape[:2], 2)
    rate = cameras.new_full((*cameras.shape[:2], 1), fps)
    return torch.cat([rate, normalized, axis_and_position, motion], dim=-1).float()


def _camera(intrinsics: Tensor, sizes: Tensor, ego_from_camera: Tensor, kind: CameraNumbers) -> Tensor:
    """Normalized intrinsics, optical axis and position, ``[B, T, V, 10]``."""
    width, height = sizes[..., 0], sizes[..., 1]
    scaled = _normalized(
        intrinsics[..., 0, 0] / height,
        intrinsics[..., 1, 1] / height,
        intrinsics[..., 0, 2] / width,
        intrinsics[..., 1, 2] / height,
        kind,
    )
    return torch.cat([scaled, ego_from_camera.flatten(-2)[..., _POSE_ELEMENTS]], dim=-1)


def _normalized(fx: Tensor, fy: Tensor, cx: Tensor, cy: Tensor, kind: CameraNumbers) -> Tensor:
    """Return fx/H, fy/H, cx/W, cy/H ``[..]`` as the four numbers of a kind, ``[.., 4]``."""
    if kind not in CAMERA_NUMBERS:
        raise ValueError(f"expected camera numbers of {' or '.join(CAMERA_NUMBERS)}, found {kind}")
    numbers: Sequence[Tensor] = (fx, fy, cx, cy) if kind == "fx,fy,cx,cy" else (fx, torch.zeros_like(fx), cx, fy)
    return torch.stack(list(numbers), dim=-1)


def _action(global_from_ego: Tensor, fps: Tensor) -> Tensor:
    """Speed and steering since the previous frame, ``[B, T, V, 2]``; ``fps`` is ``[B, 1, 1]``."""
    motion = torch.linalg.inv(global_from_ego[:, :-1]) @ global_from_ego[:, 1:]
    distance = motion[..., :3, 3].norm(dim=-1)
    yaw = torch.atan2(motion[..., 1, 0], motion[..., 0, 0])
    action = torch.stack([distance * fps * 3.6, _steering(distance, yaw)], dim=-1)
    return torch.cat([action[:, :1], action], dim=1)


def _steering(distance: Tensor, yaw: Tensor) -> Tensor:
    return torch.where(distance > _MIN_DISTANCE_M, yaw / distance * WHEELBASE_M * STEERING_RATIO, NO_STEERING)
