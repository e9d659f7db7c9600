"""Actors of requests, which have no IDs, and the tracks of a log."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import grpc
import numpy as np

import pskel
from pskel.alpasim import poses, video_model_pb2
from pskel.alpasim.poses import Matrix

from ..errors import RequestError, invalid

#: Largest distance of an actor to the box of its track in the log, meters.
REACH_M = 5.0
#: Largest difference of the sides of two boxes of one actor, meters, and as a share of the side.
SIDE_M, SIDE_SHARE = 0.3, 0.1
#: Largest distance of an actor to where it is expected after its last chunk, meters, and its growth per second, with and without
#: a known velocity.
STEP_M, STEP_MPS, FASTEST_MPS = 1.0, 2.0, 70.0
#: Categories of actors that are no track of the log. OTHER has no template, and no box is drawn of it: it is not shown.
CATEGORIES: dict[int, str] = {
    video_model_pb2.CAR: "vehicle.car",
    video_model_pb2.TRUCK: "vehicle.truck",
    video_model_pb2.PEDESTRIAN: "human.pedestrian.adult",
    video_model_pb2.CYCLIST: "vehicle.bicycle",
    video_model_pb2.OTHER: "movable_object",
}


@dataclass(frozen=True)
class Asked:
    """An actor of a chunk: class, size (length, width, height, meters), and poses ``global_from_box`` by time, in rising order."""

    class_id: int
    size: tuple[float, float, float]
    poses: dict[int, Matrix]


@dataclass(frozen=True)
class Role:
    """The name, category and size with which an actor is rendered."""

    track: str
    category: str
    size: tuple[float, float, float]


@dataclass(frozen=True)
class _Known:
    """An actor of earlier chunks with its last position, global meters, and its velocity if it had more than one."""

    class_id: int
    size: tuple[float, float, float]
    role: Role
    t_us: int
    position: Matrix
    velocity: Matrix | None

    def away(self, actor: Asked) -> float | None:
        """Return the distance of an actor's first pose to where this one is expected; ``None`` if it is another actor."""
        t_us, pose = next(iter(actor.poses.items()))
        seconds = (t_us - self.t_us) * 1e-6
        expected = self.position if self.velocity is None else self.position + seconds * self.velocity
        most = STEP_M + seconds * (FASTEST_MPS if self.velocity is None else STEP_MPS)
        away = float(np.linalg.norm(pose[:3, 3] - expected))
        return away if self.class_id == actor.class_id and away <= most else None


def asked(state: video_model_pb2.DynamicWorldState, times_us: Sequence[int], origin: Matrix) -> list[Asked]:
    """Return the actors of a chunk with frames at some times. Raises ``RequestError`` for wrong classes, sizes, poses and times."""
    frames = set(times_us)
    result = []
    for number, actor in enumerate(state.actors):
        if actor.class_id not in CATEGORIES:
            names = {value: name for name, value in video_model_pb2.ActorClassId.items()}
            raise invalid(f"class_id of actor {number} from CAR to OTHER", names.get(actor.class_id, actor.class_id))
        size = (actor.bbox_dims.size_x, actor.bbox_dims.size_y, actor.bbox_dims.size_z)
        if not all(0.0 < side < 1000.0 for side in size):
            raise invalid(f"bbox_dims of actor {number} above 0 and below 1000 m", list(size))
        found: dict[int, Matrix] = {}
        for at in actor.trajectory.poses:
            if at.timestamp_us not in frames or (found and at.timestamp_us <= max(found)):
                raise invalid(f"rising times of frames in the trajectory of actor {number}", at.timestamp_us)
            try:
                found[at.timestamp_us] = poses.matrix(at.pose, origin)
            except ValueError as error:
                raise RequestError(grpc.StatusCode.INVALID_ARGUMENT, f"trajectory of actor {number}: {error}") from None
        if found:
            result.append(Asked(actor.class_id, size, found))
    return result


def class_id(category: str) -> int:
    """Return the class of a category of a log."""
    parts = set(category.split("."))
    if parts & {"bicycle", "motorcycle"}:
        return video_model_pb2.CYCLIST
    if parts & {"stroller", "pedestrian"}:
        return video_model_pb2.PEDESTRIAN
    if parts & {"bus", "truck", "construction", "trailer"}:
        return video_model_pb2.TRUCK
    return video_model_pb2.CAR if "vehicle" in parts else video_model_pb2.OTHER


class Cast:
    """The actors of a session and the tracks that were found for them."""

    def __init__(self, log: pskel.Log) -> None:
        self._log = log
        self._start_us, self._end_us = log.times_us[0], log.times_us[-1]
        self._known: dict[str, _Known] = {}
        self._tracks: set[str] = set()
        self._unmatched = 0
        self._hidden = 0

    @property
    def summary(self) -> str:
        """How many actors are tracks of the log, and how many are not."""
        return f"{len(self._tracks)} tracks of the log, {self._unmatched} other actors ({self._hidden} of class OTHER, not shown)"

    def roles(self, actors: Sequence[Asked]) -> list[Role]:
        """Return the role of each actor of the next chunk.

        Actors of earlier chunks retain theirs: they have the same class, a similar size, and are near where they are expected. Others
        get the nearest track of the log at that time that has the same class and a similar size and that no other actor of the chunk
        has, else a new name. Nearest pairs come first; ties go to the first actor, then to the first name.
        """
        names = sorted(self._known)
        costs = (
            (_cost(known.away(actor), actor.size, known.size), index, name)
            for index, actor in enumerate(actors)
            for name in names
            if (known := self._known[name])
        )
        found = {index: self._known[name].role for index, name in _nearest(costs)}
        taken = {role.track for role in found.values()}
        others = [(index, actor, box) for index, actor in enumerate(actors) if index not in found for box in self._boxes(actor)]
        costs = (
            (_cost(_distance(actor, box), actor.size, box.size), index, box.track)
            for index, actor, box in others
            if box.track not in taken
        )
        chosen = set(_nearest(costs))
        for index, _, box in others:
            if (index, box.track) in chosen:
                length, width, height = box.size
                found[index] = Role(box.track, box.category, (length, width, height))
                self._tracks.add(box.track)
        for index, actor in enumerate(actors):
            if index not in found:
                self._unmatched += 1
                self._hidden += actor.class_id == video_model_pb2.OTHER
                found[index] = Role(f"alpasim-{self._unmatched}", CATEGORIES[actor.class_id], actor.size)
        for index, actor in enumerate(actors):
            self._known[found[index].track] = _after(actor, found[index], self._known.get(found[index].track))
        return [found[index] for index in range(len(actors))]

    def _boxes(self, actor: Asked) -> list[pskel.Actor]:
        """Return the boxes of the log at the time of an actor's first pose, or at the nearest time of the log."""
        return self._log.at(min(max(next(iter(actor.poses)), self._start_us), self._end_us)).actors


def _nearest(costs: Iterable[tuple[float | None, int, str]]) -> list[tuple[int, str]]:
    """Return pairs in which each number and each name occurs once, those with the least cost first; ``None`` is no pair."""
    numbers: set[int] = set()
    names: set[str] = set()
    chosen = []
    for _, number, name in sorted((cost, number, name) for cost, number, name in costs if cost is not None):
        if number not in numbers and name not in names:
            numbers.add(number)
            names.add(name)
            chosen.append((number, name))
    return chosen


def _cost(away: float | None, size: Sequence[float], other: Sequence[float]) -> float | None:
    """Return a distance plus the differences of the sides of two boxes, meters; ``None`` without a distance or a similar size."""
    sides = [abs(a - b) for a, b in zip(size, other, strict=True)]
    similar = all(side <= max(SIDE_M, SIDE_SHARE * b) for side, b in zip(sides, other, strict=True))
    return away + sum(sides) if away is not None and similar else None


def _distance(actor: Asked, box: pskel.Actor) -> float | None:
    """Return the distance between the centers of an actor's first pose and a box of its class; ``None`` if it is too large."""
    away = float(np.linalg.norm(next(iter(actor.poses.values()))[:3, 3] - box.global_from_box[:3, 3]))
    return away if class_id(box.category) == actor.class_id and away <= REACH_M else None


def _after(actor: Asked, role: Role, before: _Known | None) -> _Known:
    """Return what is known of an actor after a chunk."""
    known = [(t_us, pose[:3, 3]) for t_us, pose in actor.poses.items()]
    if len(known) == 1 and before is not None:
        known = [(before.t_us, before.position), *known]
    (first_us, first), (last_us, last) = known[0], known[-1]
    velocity = (last - first) / ((last_us - first_us) * 1e-6) if len(known) > 1 else None
    return _Known(actor.class_id, actor.size, role, last_us, last, velocity)
