"""Input of agents where NAVSIM is not installed: classes with the names and fields of ``navsim.common.dataclasses``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class Camera:
    """Image ``uint8 [H, W, 3]``, pose in the ego frame (``[3, 3]``, ``[3]``, meters), intrinsics ``[3, 3]``, distortion ``[5]``."""

    image: Any = None
    sensor2lidar_rotation: Any = None
    sensor2lidar_translation: Any = None
    intrinsics: Any = None
    distortion: Any = None
    camera_path: Any = None


@dataclass
class Cameras:
    """Cameras of a frame; cameras that were not requested are empty."""

    cam_f0: Camera
    cam_l0: Camera
    cam_l1: Camera
    cam_l2: Camera
    cam_r0: Camera
    cam_r1: Camera
    cam_r2: Camera
    cam_b0: Camera


@dataclass
class Lidar:
    """Points ``float32 [6, N]`` in the ego frame: x, y, z, intensity, ring, device; empty without ``--lidar``."""

    lidar_pc: Any = None
    lidar_path: Any = None


@dataclass
class EgoStatus:
    """Pose in the ego frame of the last frame (x, y, heading), velocity and acceleration in its own ego frame, command."""

    ego_pose: Any
    ego_velocity: Any
    ego_acceleration: Any
    driving_command: Any
    in_global_frame: bool = False


@dataclass
class AgentInput:
    """Four frames; the last one is now."""

    ego_statuses: list[EgoStatus]
    cameras: list[Cameras]
    lidars: list[Lidar]
