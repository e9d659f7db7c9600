"""Agents in the style of NAVSIM, without its package."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np


class Sensors:
    """Asks for the front camera in all frames, and for the rear one and the LiDAR in the last."""

    def get_sensors_at_iteration(self, iteration: int) -> list[str]:
        return ["cam_f0", "cam_b0", "lidar_pc"] if iteration == 3 else ["cam_f0"]


class Straight:
    """Drives straight on at 4 m/s, and records its input in the folder ``seen``. With the environment variable FAILS it answers nonsense from the
    second call."""

    def __init__(self, seen: str) -> None:
        self._seen = Path(seen)
        self._fails = os.environ.get("FAILS", "")
        self._calls = 0

    def initialize(self) -> None:
        self._seen.mkdir(exist_ok=True)

    def get_sensor_config(self) -> Sensors:
        return Sensors()

    def compute_trajectory(self, agent_input: Any) -> Any:
        statuses = agent_input.ego_statuses
        arrays = {name: np.array([getattr(s, name) for s in statuses]) for name in ("ego_pose", "ego_velocity", "ego_acceleration", "driving_command")}
        for index, cameras in enumerate(agent_input.cameras):
            for name in vars(cameras):
                camera = getattr(cameras, name)
                if camera.image is not None:
                    arrays[f"{name}.{index}"] = camera.image
                    arrays[f"{name}.{index}.rotation"] = camera.sensor2lidar_rotation
                    arrays[f"{name}.{index}.translation"] = camera.sensor2lidar_translation
                    arrays[f"{name}.{index}.intrinsics"] = camera.intrinsics
        for index, lidar in enumerate(agent_input.lidars):
            if lidar.lidar_pc is not None:
                arrays[f"lidar.{index}"] = lidar.lidar_pc
        np.savez(self._seen / f"{self._calls:03}.npz", **arrays)
        (self._seen / "types.json").write_text(json.dumps([type(agent_input).__module__, len(agent_input.lidars)]))
        self._calls += 1
        if self._calls > 1 and self._fails == "nan":
            return np.full((8, 3), np.nan)
        if self._calls > 1 and self._fails == "shape":
            return np.zeros((8, 2))
        return np.array([[4.0 * 0.5 * (i + 1), 0.0, 0.0] for i in range(8)])
