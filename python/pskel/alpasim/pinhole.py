"""Cameras in messages."""

from __future__ import annotations

from pskel.alpasim import poses, sensorsim_pb2
from pskel.alpasim.poses import Matrix


def pinhole(
    name: str, intrinsics: Matrix, size: tuple[int, int], ego_from_camera: Matrix
) -> sensorsim_pb2.AvailableCamerasReturn.AvailableCamera:
    """Return a pinhole camera without distortion: intrinsics ``[3, 3]`` and size (height, width) in pixels, mount ``[4, 4]`` in meters.

    ``rig_to_camera`` is the pose of the optical frame (x right, y down, z forward) in the rig, which is the ego frame.
    """
    (fx, _, cx), (_, fy, cy), _ = intrinsics.tolist()
    height, width = size
    param = sensorsim_pb2.OpenCVPinholeCameraParam(
        principal_point_x=cx,
        principal_point_y=cy,
        focal_length_x=fx,
        focal_length_y=fy,
        radial_coeffs=[0.0] * 6,
        tangential_coeffs=[0.0] * 2,
        thin_prism_coeffs=[0.0] * 4,
    )
    spec = sensorsim_pb2.CameraSpec(
        opencv_pinhole_param=param,
        logical_id=name,
        resolution_h=height,
        resolution_w=width,
        shutter_type=sensorsim_pb2.GLOBAL,
    )
    mount = poses.pose(ego_from_camera)
    return sensorsim_pb2.AvailableCamerasReturn.AvailableCamera(intrinsics=spec, rig_to_camera=mount, logical_id=name)
