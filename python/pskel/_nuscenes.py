"""Shared by the bridges to driving agents that were trained on nuScenes: images, commands, plans."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pskel import _navsim, _planner
from pskel._planner import Message, PlannerError

#: Cameras of nuScenes.
CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
#: The frame of the LiDAR, in which agents plan: right, forward, up, from 0.94 m before and 1.84 m above the rear axle.
LIDAR_FROM_EGO = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -0.94], [0.0, 0.0, 1.0, -1.84], [0.0, 0.0, 0.0, 1.0]])
#: Numbers of commands.
COMMANDS = {"right": 0, "left": 1, "straight": 2, "unknown": 2}
#: Time between the points of a plan, seconds.
INTERVAL_S = 0.5
#: Largest number of points of a plan.
MAX_POINTS = 100
#: Points nearer than this to the one before keep its heading, meters.
STILL_M = 0.1
#: Largest deviation from the aspect of 900x1600.
ASPECT = 0.05


def step_of(see: Message) -> Path:
    """Return the folder of an observation's files; raises ``PlannerError`` if it has none."""
    folder = next((Path(file).parent for file in see["files"] if Path(file).name == "meta.json"), None)
    if folder is None:
        raise PlannerError("expected images of the cameras, found none: simulate without --dry")
    return folder


def image_of(step: Path, name: str, kind: str, size: tuple[int, int], exact: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Return the image of a camera, ``uint8 [H, W, 3]``, resized to ``size`` unless its size is ``exact``.

    ``kind`` is that of ``_navsim.image_path``. Raises ``PlannerError`` for a missing image, and for another aspect than that of
    900x1600.
    """
    from PIL import Image

    image: npt.NDArray[np.uint8] = _navsim.read_image(_navsim.image_path(step, name, kind))
    height, width = image.shape[:2]
    if (height, width) == exact:
        return image
    if abs(width / height * 900 / 1600 - 1) > ASPECT:
        raise PlannerError(f"expected images of {exact[0]}x{exact[1]}, or of the aspect of 900x1600, found {height}x{width} of {name}")
    return np.asarray(Image.fromarray(image).resize(size[::-1], Image.Resampling.BICUBIC))


def points_of(values: Any, what: str) -> npt.NDArray[np.float64]:
    """Return the points of a plan, ``[N, 2]``: meters to the right and forward, every half second.

    Raises ``PlannerError``, which names the plan as ``what``, for other shapes and for numbers that are not finite.
    """
    try:
        points = np.array(values, np.float64)
    except (ValueError, TypeError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1] != 2 or not 1 <= len(points) <= MAX_POINTS or not np.isfinite(points).all():
        shown = "numbers that are not finite" if points.size and not np.isfinite(points).all() else list(points.shape)
        raise PlannerError(f"expected {what} of 1 to {MAX_POINTS} finite points [N, 2], found {shown}")
    return points


def waypoints_of(points: npt.NDArray[np.float64], ego: Message) -> list[Message]:
    """Return points of a plan as waypoints in the global frame; headings are those of the way from point to point."""
    cos, sin = math.cos(ego["heading"]), math.sin(ego["heading"])
    x, y, heading, known = ego["x"], ego["y"], ego["heading"], []
    for index, (right, forward) in enumerate(points.tolist()):
        next_x = ego["x"] + cos * forward + sin * right
        next_y = ego["y"] + sin * forward - cos * right
        if math.hypot(next_x - x, next_y - y) >= STILL_M:
            turn = math.remainder(math.atan2(next_y - y, next_x - x) - heading, math.tau)
            # Whoever drives back does not turn around.
            heading += turn if abs(turn) <= math.pi / 2 else math.remainder(turn + math.pi, math.tau)
        x, y = next_x, next_y
        known.append(((index + 1) * INTERVAL_S, x, y, heading))
    return _planner.waypoints((ego["x"], ego["y"]), known)
