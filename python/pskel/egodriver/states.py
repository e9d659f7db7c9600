"""Committed states of a rollout that is in progress."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pskel.alpasim import common_pb2, poses
from pskel.alpasim.poses import Matrix

from .driver import DriverError


@dataclass(frozen=True)
class State:
    """The ego at a step: time in microseconds, pose ``[4, 4]``, m/s, m/s², rad/s."""

    step: int
    t_us: int
    global_from_ego: Matrix
    speed_mps: float
    acceleration_mps2: float
    yaw_rate_radps: float

    def pose(self, origin: Matrix) -> common_pb2.PoseAtTime:
        """Return the pose local->rig, for a local frame with its origin at ``origin`` (``[3]``)."""
        return common_pb2.PoseAtTime(pose=poses.pose(self.global_from_ego, origin), timestamp_us=self.t_us)

    def derivatives(self) -> common_pb2.DynamicState:
        """Return the derivatives in the rig frame; the rear axle does not slip, so its velocity is along x."""
        across = self.speed_mps * self.yaw_rate_radps
        return common_pb2.DynamicState(
            angular_velocity=common_pb2.Vec3(z=self.yaw_rate_radps),
            linear_velocity=common_pb2.Vec3(x=self.speed_mps),
            linear_acceleration=common_pb2.Vec3(x=self.acceleration_mps2, y=across),
        )


class States:
    """Reader of the ``states.jsonl`` of a rollout, which has a line for each committed step."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._offset = 0
        self._origin: Matrix | None = None

    @property
    def origin(self) -> Matrix:
        """Origin of the local frame, global meters ``[3]``: the first ego position, rounded down, so it survives a resume."""
        assert self._origin is not None, "until was not called"
        return self._origin

    def until(self, step: int) -> list[State]:
        """Return the states since the previous call, up to and including ``step``."""
        states: list[State] = []
        try:
            with self._file.open("rb") as file:
                file.seek(self._offset)
                while (not states or states[-1].step < step) and (line := file.readline()).endswith(b"\n"):
                    states.append(_state(line))
                self._offset = file.tell()
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DriverError(f"expected the state of step {step} in {self._file}, found {error}") from None
        if not states or states[-1].step != step:
            found = f"step {states[-1].step}" if states else "its end"
            raise DriverError(f"expected the state of step {step} in {self._file}, found {found}")
        if self._origin is None:
            self._origin = poses.local_origin(states[0].global_from_ego[:3, 3])
        return states


def _state(line: bytes) -> State:
    row = json.loads(line)
    ego = row["ego"]
    matrix = np.array(ego["global_from_ego"], dtype=np.float64).reshape(4, 4)
    return State(row["step"], row["t_us"], matrix, ego["speed_mps"], ego["acceleration_mps2"], ego["yaw_rate_radps"])
