"""Lines and drivable area of a map of nuScenes (map expansion), as the world dreamer of DriveArena takes them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt

__all__ = ["CELLS", "REACH_M", "RoadMap"]

#: Half the side of the square of a map around the ego, meters.
REACH_M = 50.0
#: Cells of the drivable area on each side.
CELLS = 200
#: Labels of lines.
DIVIDER, CROSSING, BOUNDARY = 0, 1, 2
_PIECE_M = 1.0
#: Distance from an edge at which both of its sides are tested, meters.
_BESIDE_M = 0.05

_Points = npt.NDArray[np.float64]
_Mask = npt.NDArray[np.bool_]
#: Rings of a polygon: its outline, then holes.
_Polygon = list[_Points]


class RoadMap:
    """A map; all results are in meters to the right and forward of a place with a heading."""

    def __init__(self, dividers: list[_Points], crossings: list[_Polygon], roads: list[_Polygon], drivable: list[_Polygon]) -> None:
        self._dividers, self._crossings, self._roads, self._drivable = dividers, crossings, roads, drivable

    @classmethod
    def load(cls, path: Path) -> RoadMap:
        """Read a JSON file of the map expansion; raises ``ValueError`` for another file."""
        try:
            tables = json.loads(path.read_bytes())
            nodes = {node["token"]: (float(node["x"]), float(node["y"])) for node in tables["node"]}

            def points(tokens: list[str]) -> _Points:
                return np.array([nodes[token] for token in tokens], np.float64).reshape(-1, 2)

            lines = {line["token"]: points(line["node_tokens"]) for line in tables["line"]}
            polygons = {
                polygon["token"]: [points(polygon["exterior_node_tokens"]), *(points(hole["node_tokens"]) for hole in polygon["holes"])]
                for polygon in tables["polygon"]
            }
            return cls(
                [lines[row["line_token"]] for layer in ("road_divider", "lane_divider") for row in tables[layer]],
                [polygons[row["polygon_token"]] for row in tables["ped_crossing"]],
                [polygons[row["polygon_token"]] for layer in ("road_segment", "lane") for row in tables[layer]],
                [polygons[token] for row in tables["drivable_area"] for token in row["polygon_tokens"]],
            )
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(f"expected a map expansion of nuScenes in {path}, found {type(error).__name__}: {error}") from None

    def lines(self, x: float, y: float, heading: float) -> tuple[list[int], list[list[list[float]]]]:
        """Return the labels and the points ``[N, 2]`` of all lines around a place."""
        place = np.array([x, y]), heading
        found = [(DIVIDER, run) for line in self._dividers for run in _runs(_pieces(_local(line, *place)), None)]
        for label, polygons in ((CROSSING, self._crossings), (BOUNDARY, self._roads)):
            near = [rings for rings in ([_local(ring, *place) for ring in polygon] for polygon in polygons) if _is_near(rings[0])]
            found += [(label, run) for run in _outline(near)]
        return [label for label, _ in found], [run.tolist() for _, run in found]

    def drivable(self, x: float, y: float, heading: float) -> _Mask:
        """Return the drivable area ``[200, 200]`` around a place: cells of half a meter, from left to right and from back to front.

        In maps without this layer, such as those of DriveArena, it is the area of roads and lanes.
        """
        place = np.array([x, y]), heading
        centers = (np.arange(CELLS) + 0.5) * (2 * REACH_M / CELLS) - REACH_M
        area = np.zeros((CELLS, CELLS), np.bool_)
        for polygon in self._drivable or self._roads:
            rings = [_local(ring, *place) for ring in polygon]
            if _is_near(rings[0]):
                rows = (np.stack([centers, np.full(CELLS, forward)], axis=1) for forward in centers)
                area |= np.stack([_inside(row, rings) for row in rows], axis=1)
        return area


def _local(points: _Points, origin: _Points, heading: float) -> _Points:
    cos, sin = np.cos(heading), np.sin(heading)
    local: _Points = (points - origin) @ np.array([[sin, cos], [-cos, sin]])
    return local


def _is_near(points: _Points) -> bool:
    return len(points) > 2 and bool((points.min(axis=0) < REACH_M).all() and (points.max(axis=0) > -REACH_M).all())


def _pieces(points: _Points) -> _Points:
    """Return a line with a point at least at every meter; an empty one if it is not near."""
    if len(points) < 2 or (points.min(axis=0) > REACH_M).any() or (points.max(axis=0) < -REACH_M).any():
        return points[:0]
    counts = np.maximum(np.ceil(np.linalg.norm(np.diff(points, axis=0), axis=1) / _PIECE_M).astype(int), 1)
    parts = [np.linspace(a, b, count, endpoint=False) for a, b, count in zip(points, points[1:], counts)]
    return np.concatenate([*parts, points[-1:]])


def _runs(points: _Points, is_kept: _Mask | None) -> list[_Points]:
    """Return the parts of a line within reach, and of pieces that are kept."""
    if len(points) < 2:
        return []
    within: _Mask = np.all(np.abs(points) <= REACH_M, axis=1)
    kept: _Mask = within[:-1] & within[1:]
    if is_kept is not None:
        kept &= is_kept
    ends = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]])))
    return [points[first : last + 1] for first, last in zip(ends[::2], ends[1::2])]


def _outline(polygons: list[_Polygon]) -> list[_Points]:
    """Return the outline of the union of polygons: pieces of edges with the union on one side only."""
    runs = []
    for ring in (ring for polygon in polygons for ring in polygon):
        points = _pieces(np.concatenate([ring, ring[:1]]))
        if len(points) < 2:
            continue
        steps, middles = np.diff(points, axis=0), (points[1:] + points[:-1]) / 2
        lengths = np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-9)
        beside = steps[:, ::-1] * [1, -1] / lengths * _BESIDE_M
        runs += _runs(points, _covered(middles + beside, polygons) != _covered(middles - beside, polygons))
    return runs


def _covered(points: _Points, polygons: list[_Polygon]) -> _Mask:
    """Whether points are in any of the polygons."""
    covered = np.zeros(len(points), np.bool_)
    for rings in polygons:
        low, high = rings[0].min(axis=0), rings[0].max(axis=0)
        near = np.flatnonzero(~covered & ((points >= low) & (points <= high)).all(axis=1))
        if len(near):
            covered[near] = _inside(points[near], rings)
    return covered


def _inside(points: _Points, rings: _Polygon) -> _Mask:
    """Whether points are in a polygon: an odd number of edges is to the right of them."""
    right, forward = points[:, :1], points[:, 1:]
    counts = np.zeros(len(points), np.int64)
    for ring in rings:
        edges = np.stack([ring, np.roll(ring, -1, axis=0)])
        start, end = edges[:, (edges[..., 1].min(axis=0) <= forward.max()) & (edges[..., 1].max(axis=0) >= forward.min())]
        is_crossed = (start[:, 1] <= forward) != (end[:, 1] <= forward)
        rise = np.where(is_crossed, end[:, 1] - start[:, 1], 1.0)
        at = start[:, 0] + (forward - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
        counts += (is_crossed & (at > right)).sum(axis=1)
    is_inside: _Mask = counts % 2 == 1
    return is_inside
