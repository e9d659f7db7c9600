"""Driving agents of DriveArena (UniAD, VAD) as planners."""

from __future__ import annotations

import base64
import io
import json
import math
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from pskel import _nuscenes
from pskel._planner import Message, PlannerError

from . import CAMERAS, HZ, SIZE
from .server import Server

__all__ = ["Agent"]

GRAVITY = 9.8
#: Rows of an image of 900x1600 at a quarter of its size; the first one is cut off, as in the training of the agents.
ROWS = 225
_POLL_S = 0.2


class Agent:
    """One rollout: sends images and states to an agent, and converts its plans."""

    def __init__(self, server: Server, hello: Message, images: str, timeout_s: float) -> None:
        if abs(hello["plan_hz"] - HZ) > 1e-6:
            raise PlannerError(f"expected --plan-hz 2, the rate of DriveArena's agents, found {hello['plan_hz']:g}")
        self._server, self._images, self._timeout_s = server, images, timeout_s
        self._start: tuple[int, float, float] | None = None
        self._call("get", "/driver-clean/")

    def plan(self, see: Message) -> list[Message]:
        """Return the waypoints of the agent for an observation."""
        ego = see["ego"]
        if self._start is None:
            # Agents compute with 32-bit floats.
            self._start = (see["t_us"], float(round(ego["x"])), float(round(ego["y"])))
        if self._output() is not None:
            expected = "expected an agent without plans before it is asked, found one"
            raise PlannerError(f"{expected}: does a world dreamer send it images (--agent_port)?")
        self._call("post", "/driver-api/", state_of(see, self._start, stacked(see, self._images)))
        end_s = time.monotonic() + self._timeout_s
        while (output := self._output()) is None:
            if time.monotonic() > end_s:
                raise PlannerError(f"expected a plan of the agent within {self._timeout_s:g} s, found none")
            time.sleep(_POLL_S)
        return _nuscenes.waypoints_of(points_of(output), ego)

    def _output(self) -> bytes | None:
        answer = self._call("get", "/driver-get/")
        return None if answer.status == 204 or answer.content.strip() in (b"", b"null", b"false") else answer.content

    def _call(self, method: str, *arguments: Any) -> Any:
        try:
            return getattr(self._server, method)(*arguments)
        except ValueError as error:
            raise PlannerError(str(error)) from None


def state_of(see: Message, start: tuple[int, float, float], image: bytes) -> Message:
    """Return the request of an observation; times and places are relative to the ``start`` (microseconds, meters)."""
    ego = see["ego"]
    cos, sin = math.cos(ego["heading"]), math.sin(ego["heading"])
    x, y = ego["x"] - start[1], ego["y"] - start[2]
    return {
        "timestamp": (see["t_us"] - start[0]) / 1e6,
        "img_byte_array": base64.b64encode(image).decode(),
        "ego_pose": [[cos, -sin, 0.0, x], [sin, cos, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
        "command": _nuscenes.COMMANDS[see["driving_command"]],
        "accel": [ego["a"], ego["v"] * ego["yaw_rate"], GRAVITY],
        "rotation_rate": [0.0, 0.0, ego["yaw_rate"]],
        "vel": [ego["v"], 0.0, 0.0],
    }


def stacked(see: Message, kind: str) -> bytes:
    """Return the images of all cameras, one below the other, as a PNG.

    Images of 224x400 are used as they are; others of the aspect of 900x1600 are resized to 225x400 and lose their first row.
    """
    from PIL import Image

    step, (height, width) = _nuscenes.step_of(see), SIZE
    images = [_nuscenes.image_of(step, name, kind, (ROWS, width), SIZE)[-height:] for name in CAMERAS]
    file = io.BytesIO()
    Image.fromarray(np.concatenate(images)).save(file, "PNG")
    return file.getvalue()


def points_of(output: bytes) -> npt.NDArray[np.float64]:
    """Return the points of a plan, ``[N, 2]``: meters to the right and forward, every half second.

    UniAD answers ``{"bbox_results": [{"planning_traj": [[[x, y], ..]]}]}``, VAD ``[{"planning_traj": [[x, y], ..]}]``. Raises
    ``PlannerError`` for other answers, and for numbers that are not finite.
    """
    try:
        value = json.loads(output)
        results = value["bbox_results"] if isinstance(value, dict) else value
        points = np.array(results[0]["planning_traj"], np.float64)
    except (ValueError, TypeError, KeyError, IndexError, RecursionError):
        raise PlannerError(f"expected an answer of UniAD or VAD with planning_traj, found {output[:200]!r}") from None
    return _nuscenes.points_of(points[0] if points.ndim == 3 and len(points) == 1 else points, "planning_traj")
