"""Pairs of poses in requests: at the start and the end of a frame."""

from __future__ import annotations

from collections.abc import Iterable

import grpc

from pskel.alpasim import poses, sensorsim_pb2
from pskel.alpasim.poses import Matrix

from .errors import RequestError, invalid


def both(name: str, pair: sensorsim_pb2.PosePair, origin: Matrix) -> tuple[Matrix, Matrix]:
    """Return the poses at start and end, global; the end is the start if it is missing. Raises ``RequestError``."""
    try:
        start = poses.matrix(pair.start_pose, origin)
        end = poses.matrix(pair.end_pose, origin) if pair.HasField("end_pose") else start
    except ValueError as error:
        raise RequestError(grpc.StatusCode.INVALID_ARGUMENT, f"{name}: {error}") from None
    return start, end


def tracks(objects: Iterable[sensorsim_pb2.DynamicObject], origin: Matrix) -> dict[str, tuple[Matrix, Matrix]]:
    """Return the poses of tracks at start and end, global, in the order of the objects. Raises ``RequestError``."""
    found: dict[str, tuple[Matrix, Matrix]] = {}
    for item in objects:
        if item.track_id in found:
            raise invalid("each track once", f"two of {item.track_id!r}")
        found[item.track_id] = both(f"pose_pair of track {item.track_id!r}", item.pose_pair, origin)
    return found
