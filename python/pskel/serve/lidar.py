"""LiDAR sweeps: requests to points."""

from __future__ import annotations

import numpy as np

import pskel
from pskel.alpasim import sensorsim_pb2

from . import pairs
from .errors import invalid
from .scenes import Instant, Scenes

#: Preset of each device.
DEVICES = {sensorsim_pb2.PANDAR128: "pandar128", sensorsim_pb2.AT128: "at128"}


def swept(scenes: Scenes, request: sensorsim_pb2.LidarRenderRequest) -> sensorsim_pb2.LidarRenderReturn:
    """Render a sweep from the start to the end of a frame.

    Points are in the frame of the device at the end; intensities are 0, since skeletons do not keep them. Raises ``RequestError``.
    """
    scene = scenes.get(request.scene_id)
    device = DEVICES.get(request.lidar_config.lidar_type)
    if device is None:
        raise invalid("lidar_type PANDAR128 or AT128", request.lidar_config.lidar_type)
    start_us, end_us = request.frame_start_us, request.frame_end_us
    if end_us < start_us:
        raise invalid(f"frame_end_us from frame_start_us {start_us} on", end_us)
    mounts = pairs.both("sensor_pose", request.sensor_pose, scene.origin)
    tracks = pairs.tracks(request.dynamic_objects, scene.origin)
    start, end = (
        Instant(t_us, mounts[at], [scene.actor(track, t_us, boxes[at]) for track, boxes in tracks.items()])
        for at, t_us in enumerate((start_us, end_us))
    )
    sweep: pskel.LidarSweep = scene.sweep(device, start, end)
    points = np.ascontiguousarray(sweep["points"], "<f4")
    return sensorsim_pb2.LidarRenderReturn(
        num_points=len(points),
        point_xyzs_buffer=points.tobytes(),
        point_intensities_buffer=np.zeros(len(points), "<f4").tobytes(),
    )
