"""Scenes: logs with their skeletons, opened when they are asked for."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import numpy as np

import pskel
from pskel.alpasim import poses
from pskel.alpasim.poses import Matrix

from .cameras import Projection
from .errors import unknown


@dataclass(frozen=True)
class RigCamera:
    """A camera of a log: intrinsics ``[3, 3]`` at its size (height, width), and its pose in the ego frame ``[4, 4]``."""

    intrinsics: Matrix
    size: tuple[int, int]
    ego_from_camera: Matrix


@dataclass(frozen=True)
class Instant:
    """A time of a LiDAR sweep: microseconds, the pose of the device ``[4, 4]``, and the actors."""

    t_us: int
    device: Matrix
    actors: Sequence[pskel.Actor]


class Scene:
    """An open scene. Its methods may be called from any thread."""

    def __init__(self, log: pskel.Log, skeleton: pskel.Skeleton, splat: str | None) -> None:
        self.log = log
        self.skeleton = skeleton
        self.renderer = pskel.Renderer(skeleton, maps=["color", "depth"], log=log.name, splat=splat)
        frames = [log[index] for index in range(len(log))]
        self.first = first = log.at(log.times_us[0])
        self.trajectory = [(scene.t_us, scene.ego) for scene in frames]
        self.origin = poses.local_origin(first.ego[:3, 3])
        mounts = np.linalg.inv(first.ego) @ np.linalg.inv(first.camera_from_global)
        known = zip(first.cameras, first.intrinsics, first.sizes, mounts, strict=True)
        self.cameras = {name: RigCamera(k, size, mount) for name, k, size, mount in known}
        self._tracks: dict[str, list[tuple[int, pskel.Actor]]] = {}
        for scene in frames:
            for actor in scene.actors:
                self._tracks.setdefault(actor.track, []).append((scene.t_us, actor))

    def actor(self, track: str, t_us: int, global_from_box: Matrix) -> pskel.Actor:
        """Return a track with the box that it had in the log nearest in time, at a pose. Raises ``RequestError`` for unknown tracks."""
        boxes = self._tracks.get(track)
        if boxes is None:
            raise unknown(f"a track of the scene (it has {len(self._tracks)})", repr(track))
        after = bisect_left(boxes, t_us, key=lambda item: item[0])
        near = min(boxes[max(after - 1, 0) : after + 1], key=lambda item: abs(item[0] - t_us))[1]
        return pskel.Actor(track, near.category, near.size, global_from_box)

    def render(
        self, ego: Matrix, views: Sequence[tuple[Projection, Matrix]], actors: Sequence[pskel.Actor]
    ) -> pskel.Maps:
        """Render color and depth ``[V, H, W, ..]`` for projections of one size and ``global_from_camera``."""
        cameras = [
            pskel.Camera(f"camera{number}", projection.intrinsics, projection.size, np.linalg.inv(ego) @ pose)
            for number, (projection, pose) in enumerate(views)
        ]
        return self.renderer.render(pskel.Scene(ego, cameras, actors))

    def sweep(self, spec: str, start: Instant, end: Instant) -> pskel.LidarSweep:
        """Render a LiDAR sweep from its start to its end, in the frame of the device at its end."""
        before, now = (pskel.Scene(at.device, [], at.actors, t_us=at.t_us) for at in (start, end))
        return self.renderer.lidar(now, spec, other=before, position=(0.0, 0.0, 0.0))


class Scenes:
    """All scenes of a server by name; at most ``capacity`` of them, the last used, are open."""

    def __init__(self, sources: Mapping[str, tuple[str, Path]], capacity: int, splat: str | None) -> None:
        self._sources = dict(sources)
        self._splat = splat
        self.capacity = capacity
        self._open: OrderedDict[str, Scene] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def names(self) -> list[str]:
        """Names of all scenes, sorted."""
        return sorted(self._sources)

    @property
    def loaded(self) -> list[str]:
        """Names of the open scenes, sorted."""
        with self._lock:
            return sorted(self._open)

    def get(self, name: str) -> Scene:
        """Return a scene, which is opened if necessary. Raises ``RequestError`` for unknown ones, ``pskel.Error`` for damaged ones."""
        if name not in self._sources:
            raise unknown(f"a scene among {', '.join(self.names)}", repr(name))
        with self._lock:
            scene = self._open.pop(name, None)
            if scene is None:
                log, skeleton = self._sources[name]
                scene = Scene(pskel.Log(log), pskel.Skeleton(skeleton), self._splat)
            self._open[name] = scene
            while len(self._open) > self.capacity:
                self._open.popitem(last=False)  # closes with its last request
        return scene


def sources(skeletons: Sequence[str], logs: Sequence[str]) -> dict[str, tuple[str, Path]]:
    """Return how each log is opened and its skeleton, by the name of the log.

    Raises ``ValueError`` for a log that no or more than one skeleton has, and for a skeleton without a log.
    """
    held = [(skeleton, pskel.Skeleton(skeleton).logs) for skeleton in skeletons]
    found: dict[str, tuple[str, Path]] = {}
    for text in logs:
        name = pskel.Log(text).name
        those = [skeleton for skeleton, names in held if name in names]
        if len(those) != 1 or name in found:
            wrong = "two logs of that name" if name in found else f"{len(those)}"
            raise ValueError(f"expected one skeleton with log {name} ({text}), found {wrong}")
        found[name] = (text, Path(those[0]))
    for skeleton, names in held:
        if not set(names) & set(found):
            raise ValueError(f"expected --log for one of {', '.join(names)}, the logs of {skeleton}, found none")
    return found
