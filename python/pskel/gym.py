"""Gymnasium environment ``pskel/Drive-v0``: drive the ego through a log in closed loop.

``gymnasium.make("pskel.gym:pskel/Drive-v0", log="town:seed=7,frames=40", skeleton="out/skeleton")``
"""

from __future__ import annotations

import os
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import SyncVectorEnv
except ImportError as error:
    raise ImportError("pskel.gym needs gymnasium: pip install 'pskel[gym]'") from error

from . import Log, Renderer, Simulation, Skeleton, lidar_spec
from ._arrays import numbers

__all__ = ["ACTORS", "ROUTE", "DriveEnv", "make_vector"]

ROUTE = 20
"""Points of the recorded path in an observation."""
ACTORS = 32
"""Maximum number of actors in an observation, the nearest ones."""

_ROUTE_STEP = 5  # meters; the path of an observation has a point per meter
_MAX_SPEED = 40.0  # meters per second; faster plans are slowed down
_WHEELBASE = 3.089  # meters
_WAYPOINTS = 8
_WAYPOINT_DT = 0.5  # seconds
_SIM_HZ = 10.0

_Observation = dict[str, npt.NDArray[Any]]


class DriveEnv(gymnasium.Env[_Observation, npt.NDArray[np.float32]]):
    """Drives the ego of a log; other road users follow the log or react.

    An episode starts at a random key frame of the first half of the log and has ``steps`` planning steps, ``plan_hz`` per
    second (1, 2, 5 or 10). A simulation step (``index`` in ``info``) is 0.1 s.

    Observation (ego frame: x forward, y left; meters, radians, seconds):

    - ``images`` ``uint8 [V, H, W, 3]``: color maps of all cameras,
    - ``ego`` ``float32 [4]``: speed, acceleration, yaw rate, steering angle,
    - ``route`` ``float32 [20, 2]``: points of the recorded path ahead, 5 m apart; the last one repeats at its end,
    - ``actors`` ``float32 [32, 7]``: x, y, heading, length, width, speed, 1; rows of zeros after the last,
    - with ``lidar``, a preset or a JSON file, ``lidar`` ``float32 [N, 6]``: x, y, z, intensity (0), ring, 1 of each return of
      ``N`` rays; rows of zeros after the last. Devices without a mount are where the log's LiDAR is.

    Action: ``float32 [8, 3]`` waypoints (x, y, heading every 0.5 s, at most 40 m/s), or with ``action="controls"``
    ``float32 [2]``: acceleration (-6 to 3 m/s²) and steering angle (-0.6 to 0.6) of a kinematic bicycle.

    Reward: progress along the recorded path in units of 10 m, less 10 for a collision. A collision ends the episode
    (``terminated``). ``info`` has the ``metrics`` of the simulation and its ``index``.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}

    def __init__(
        self,
        log: str,
        skeleton: str | os.PathLike[str],
        *,
        size: tuple[int, int] = (112, 200),
        steps: int = 50,
        plan_hz: float = 5.0,
        actors: str = "reactive",
        action: str = "waypoints",
        rasterizer: str = "auto",
        lidar: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        if action not in ("waypoints", "controls"):
            raise ValueError(f"expected the action waypoints or controls, found {action!r}")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"expected the render mode rgb_array, found {render_mode!r}")
        self.render_mode = render_mode
        self._log = _log(log, os.getpid())
        self._renderer = _renderer(os.fspath(skeleton), tuple(size), rasterizer, os.getpid())
        self._options: dict[str, Any] = {
            "steps": steps * round(_SIM_HZ / plan_hz),
            "sim_hz": _SIM_HZ,
            "plan_hz": plan_hz,
            "actors": actors,
        }
        self._simulation: Simulation | None = None
        self._seen: dict[str, Any] = {}
        self._images: npt.NDArray[np.uint8] | None = None
        cameras, (height, width) = len(self._log[0].cameras), size
        self._lidar, self._rays = lidar, _rays(lidar)
        space: Any = spaces.Dict(
            {
                "images": spaces.Box(0, 255, (cameras, height, width, 3), np.uint8),
                "ego": spaces.Box(-np.inf, np.inf, (4,), np.float32),
                "route": spaces.Box(-np.inf, np.inf, (ROUTE, 2), np.float32),
                "actors": spaces.Box(-np.inf, np.inf, (ACTORS, 7), np.float32),
                **({"lidar": spaces.Box(-np.inf, np.inf, (self._rays, 6), np.float32)} if lidar else {}),
            }
        )
        self.observation_space = space
        self._controls = action == "controls"
        if self._controls:
            low, high = np.array([-6.0, -0.6]), np.array([3.0, 0.6])
        else:
            low = np.tile([-40.0, -80.0, -np.pi], (_WAYPOINTS, 1))
            high = np.tile([160.0, 80.0, np.pi], (_WAYPOINTS, 1))
        self.action_space = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[_Observation, dict[str, Any]]:
        """Start an episode; ``options={"frame": i}`` chooses the key frame."""
        super().reset(seed=seed)
        times = self._log.times_us
        frame = (options or {}).get("frame")
        if frame is None:
            frame = int(self.np_random.integers(max(1, len(times) // 2)))
        if not 0 <= frame < len(times):
            raise ValueError(f"expected a frame below {len(times)}, found {frame}")
        simulation = Simulation(self._log, start_us=times[frame], **self._options)
        self._simulation = simulation
        self._seen = next(simulation)
        return self._observe(simulation), self._info(simulation)

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[_Observation, float, bool, bool, dict[str, Any]]:
        """Follow a plan until the next planning step."""
        simulation = self._simulation
        if simulation is None:
            raise RuntimeError("expected a reset before this step, found none")
        chosen = numbers(action).astype(np.float64)
        if chosen.shape != self.action_space.shape:
            raise ValueError(f"expected an action {list(self.action_space.shape or ())}, found {list(chosen.shape)}")
        before = simulation.metrics["progress_m"]
        if self._controls:
            simulation.act(_driven(chosen, self._seen["ego"]["v"], self._seen["plan_dt"]))
        else:
            simulation.act(_limited(chosen), dt=_WAYPOINT_DT)
        ended = next(simulation, None) is None
        self._seen = simulation.observation
        metrics = simulation.metrics
        collided = bool(metrics["collisions"])
        reward = (metrics["progress_m"] - before) / 10.0 - 10.0 * collided
        if collided or ended:
            self._simulation = None
        return self._observe(simulation), reward, collided, ended and not collided, self._info(simulation)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return the images of all cameras side by side, ``[H, V * W, 3]``."""
        if self.render_mode is None or self._images is None:
            return None
        return np.concatenate(list(self._images), axis=1)

    def _observe(self, simulation: Simulation) -> _Observation:
        self._images = self._renderer.render(simulation.scene)["color"]
        ego = self._seen["ego"]
        return {
            "images": self._images,
            "ego": np.array([ego["v"], ego["a"], ego["yaw_rate"], ego["steering"]], np.float32),
            "route": _route(self._seen["path"], ego),
            "actors": _actors(self._seen["actors"], ego),
            **({"lidar": self._sweep(simulation)} if self._lidar else {}),
        }

    def _sweep(self, simulation: Simulation) -> npt.NDArray[np.float32]:
        assert self._lidar is not None
        at = self._log.lidar_position
        sweep = self._renderer.lidar(simulation.scene, self._lidar, other=simulation.previous, position=at)
        count = len(sweep["points"])
        returns = np.zeros((self._rays, 6), np.float32)
        returns[:count] = np.column_stack([sweep["points"], sweep["intensity"], sweep["ring"], np.ones(count)])
        return returns

    def _info(self, simulation: Simulation) -> dict[str, Any]:
        return {"metrics": simulation.metrics, "index": simulation.index}


def make_vector(num_envs: int = 1, **options: Any) -> SyncVectorEnv:
    """Create environments that step one after the other; they share one device and one log."""
    return SyncVectorEnv([lambda: DriveEnv(**options)] * num_envs)


def _rays(lidar: str | None) -> int:
    devices = lidar_spec(lidar)["devices"] if lidar else []
    return sum(len(device["elevations_deg"]) * device["columns"] for device in devices)


@lru_cache(maxsize=4)
def _log(name: str, process: int) -> Log:
    return Log(name)


@lru_cache(maxsize=2)
def _renderer(skeleton: str, size: tuple[int, int], rasterizer: str, process: int) -> Renderer:
    return Renderer(Skeleton(skeleton), out_size=size, maps=["color"], rasterizer=rasterizer)


def _local(points: npt.NDArray[np.float64], ego: dict[str, float]) -> npt.NDArray[np.float64]:
    """Converts global x and y to the ego frame."""
    away = points - np.array([ego["x"], ego["y"]])
    cos, sin = np.cos(ego["heading"]), np.sin(ego["heading"])
    local: npt.NDArray[np.float64] = away @ np.array([[cos, -sin], [sin, cos]])
    return local


def _route(path: list[list[float]], ego: dict[str, float]) -> npt.NDArray[np.float32]:
    route = np.zeros((ROUTE, 2), np.float32)
    if path:
        chosen = [path[min(i * _ROUTE_STEP, len(path) - 1)] for i in range(ROUTE)]
        route[:] = _local(np.array(chosen), ego)
    return route


def _actors(actors: list[dict[str, Any]], ego: dict[str, float]) -> npt.NDArray[np.float32]:
    rows = np.zeros((ACTORS, 7), np.float32)
    if not actors:
        return rows
    places = _local(np.array([[actor["x"], actor["y"]] for actor in actors]), ego)
    nearest = np.argsort(np.linalg.norm(places, axis=1), kind="stable")[:ACTORS]
    for row, index in enumerate(nearest):
        actor = actors[index]
        heading = (actor["heading"] - ego["heading"] + np.pi) % (2.0 * np.pi) - np.pi
        rows[row] = *places[index], heading, actor["length"], actor["width"], actor["v"], 1.0
    return rows


def _limited(waypoints: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Shortens the way between waypoints to the maximum speed."""
    limited = waypoints.copy()
    before = np.zeros(2)
    for row in limited:
        way = row[:2] - before
        row[:2] = before + way * min(1.0, _MAX_SPEED * _WAYPOINT_DT / max(float(np.linalg.norm(way)), 1e-9))
        before = row[:2]
    return limited


def _driven(controls: npt.NDArray[np.float64], speed: float, plan_dt: float) -> npt.NDArray[np.float64]:
    """Returns the waypoints of a kinematic bicycle with constant acceleration and steering angle: one second, or the
    time between plans if it is longer."""
    acceleration, steering = np.clip(controls, [-6.0, -0.6], [3.0, 0.6])
    dt = 0.1
    x = y = heading = 0.0
    rows = []
    for i in range(1, int(np.ceil(max(1.0, plan_dt) / dt)) + 1):
        speed = min(max(speed + acceleration * dt, 0.0), _MAX_SPEED)
        heading += speed * np.tan(steering) / _WHEELBASE * dt
        x += speed * np.cos(heading) * dt
        y += speed * np.sin(heading) * dt
        rows.append([i * dt, x, y, heading, speed])
    return np.array(rows)


gymnasium.register(
    "pskel/Drive-v0", entry_point="pskel.gym:DriveEnv", vector_entry_point="pskel.gym:make_vector"
)
