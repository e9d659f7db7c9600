"""Agents of NAVSIM for ``pskel simulate``: ``--planner "python -m pskel.navsim_agent MODULE:CLASS"`` (docs/src/reference/interop.md).

Runs in the environment of NAVSIM, Python 3.9 or later, or in any with NumPy and Pillow; the compiled part of ``pskel`` is not
needed. ``MODULE:CLASS`` is an ``AbstractAgent``, or anything with ``compute_trajectory`` and, if it likes, ``initialize`` and
``get_sensor_config``. Without NAVSIM its input are classes of the same names and fields.
"""

from __future__ import annotations

import importlib
import math
import sys
from collections import deque
from typing import Any

import numpy as np

from pskel import _navsim_types, _planner
from pskel._arrays import numbers
from pskel._navsim import CAMERAS, FRAME_S, FRAMES, IMAGES_HELP, camera, driving_command, ego_status, lidar, relative
from pskel._planner import Message, PlannerError

#: Horizon and interval of a trajectory that has no ``trajectory_sampling``, seconds.
INTERVAL_S = 0.5


class Bridge:
    """One rollout: collects frames at 2 Hz for an agent, and converts its trajectories."""

    def __init__(self, agent: Any, hello: Message, images: str) -> None:
        self._agent = agent
        self._images = images
        self._states: deque[Message] = deque()
        self._tolerance_us = 0.5e6 / hello["sim_hz"]
        try:
            self._types: Any = importlib.import_module("navsim.common.dataclasses")
        except ImportError:
            self._types = _navsim_types
        if hasattr(agent, "initialize"):
            agent.initialize()
        self._sensors = agent.get_sensor_config() if hasattr(agent, "get_sensor_config") else None

    def plan(self, see: Message) -> list[Message]:
        """Return the waypoints of the agent for an observation."""
        self._states.extend((*see["history"], see))
        while see["t_us"] - self._states[0]["t_us"] > 1e6 * FRAME_S * (FRAMES - 1) + self._tolerance_us:
            self._states.popleft()
        frames = [self._frame(see["t_us"], FRAMES - 1 - index) for index in range(FRAMES)]
        planned = self._agent.compute_trajectory(self._input(frames))
        poses = numbers(getattr(planned, "poses", planned)).astype(np.float64)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or not np.isfinite(poses).all():
            raise PlannerError(f"expected a trajectory of finite poses [N, 3], found {poses.dtype} {list(poses.shape)}")
        interval_s = float(getattr(getattr(planned, "trajectory_sampling", None), "interval_length", INTERVAL_S))
        ego = see["ego"]
        cos, sin = math.cos(ego["heading"]), math.sin(ego["heading"])
        points = [
            ((i + 1) * interval_s, ego["x"] + cos * x - sin * y, ego["y"] + sin * x + cos * y, ego["heading"] + turn)
            for i, (x, y, turn) in enumerate(poses.tolist())
        ]
        return _planner.waypoints((ego["x"], ego["y"]), points)

    def _frame(self, now_us: int, back: int) -> Message:
        """Return the state of a frame, ``back`` frames before now."""
        due_us = now_us - back * FRAME_S * 1e6
        nearest = min(self._states, key=lambda state: abs(state["t_us"] - due_us))
        if abs(nearest["t_us"] - due_us) > self._tolerance_us:
            raise PlannerError(
                f"expected a state {back * FRAME_S:g} s before step {self._states[-1]['step']}, found none; start later in the log"
            )
        return nearest

    def _input(self, frames: list[Message]) -> Any:
        now = frames[-1]["ego"]
        statuses, cameras = [], []
        for index, state in enumerate(frames):
            status = ego_status(state["ego"], driving_command(state))
            pose = relative(status["ego_pose"], now)
            statuses.append(self._types.EgoStatus(**{**status, "ego_pose": pose, "in_global_frame": False}))
            cameras.append(self._cameras(state, index))
        return self._types.AgentInput(statuses, cameras, [self._lidar(state, index) for index, state in enumerate(frames)])

    def _wanted(self, index: int) -> set[str]:
        """Return the sensors of a frame that the agent asks for: by default all."""
        return {*CAMERAS, "lidar_pc"} if self._sensors is None else set(self._sensors.get_sensors_at_iteration(index))

    def _lidar(self, state: Message, index: int) -> Any:
        """Return the sweep of a frame, if the agent asks for it and the rollout has one."""
        found = lidar(state["files"]) if "lidar_pc" in self._wanted(index) else None
        return self._types.Lidar(**found) if found else self._types.Lidar()

    def _cameras(self, state: Message, index: int) -> Any:
        """Return the cameras of a frame that the agent asks for."""
        wanted = self._wanted(index) & set(CAMERAS)
        made = {}
        for name in CAMERAS:
            found = camera(state["files"], name, self._images) if name in wanted else None
            made[name] = self._types.Camera(**found) if found else self._types.Camera()
        if wanted and all(made[name].image is None for name in wanted):
            raise PlannerError(
                f"expected an image of {', '.join(sorted(wanted))} at step {state['step']}, found none; use --warmup 4 --plan-hz 2"
            )
        return self._types.Cameras(**made)


def main(arguments: list[str]) -> int:
    """Run the command; returns its exit code."""
    parser = _planner.parser("navsim_agent", "an AbstractAgent of NAVSIM", "Plan for pskel simulate with an agent of NAVSIM.")
    parser.add_argument("--images", metavar="KIND", default="auto", help=IMAGES_HELP)
    given = parser.parse_args(arguments)
    lines, out = _planner.messages()
    return _planner.serve(lambda hello: Bridge(_planner.create(given.name, given.args), hello, given.images).plan, lines, out)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
