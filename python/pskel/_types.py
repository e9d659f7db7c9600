"""Types of results and of keyword arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import TypedDict

import numpy as np
import numpy.typing as npt

Maps = TypedDict(
    "Maps",
    {
        "color": npt.NDArray[np.uint8],
        "depth": npt.NDArray[np.float32],
        "class": npt.NDArray[np.uint8],
        "instance": npt.NDArray[np.uint32],
        "boxes": npt.NDArray[np.uint8],
        "map": npt.NDArray[np.uint8],
        "point": npt.NDArray[np.uint32],
        "points": npt.NDArray[np.float32],
        "layout": npt.NDArray[np.float32],
    },
    total=False,
)
"""Maps of a scene over all cameras; the requested ones are present.

``color``, ``boxes`` and ``map`` are RGB ``[V, H, W, 3]``; ``depth`` is ``[V, H, W]`` in meters, ``inf`` where empty;
``class``, ``instance`` and ``point`` are ``[V, H, W]``, 0 where empty. ``points`` ``[V, 20, H, W]`` and ``layout``
``[V, 6, H, W]`` are the map ``tensor``, the network input.
"""


LidarSweep = TypedDict(
    "LidarSweep",
    {
        "points": npt.NDArray[np.float32],
        "intensity": npt.NDArray[np.float32],
        "ring": npt.NDArray[np.uint16],
        "device": npt.NDArray[np.uint8],
        "class": npt.NDArray[np.uint8],
        "instance": npt.NDArray[np.uint32],
        "time": npt.NDArray[np.float32],
        "range": list[npt.NDArray[np.float32]],
    },
)
"""Returns of a LiDAR.

``points`` ``[N, 3]`` in meters, in the ego frame at the time of the scene; ``intensity`` (0), ``ring``, ``device``, ``class``,
``instance`` and ``time`` (seconds after the scene's) are ``[N]``. ``range`` has an array ``[beams, columns]`` per device, meters,
0 without a return.
"""


class Track(TypedDict):
    """Track of a log: id, category, median length, width and height, times of the first and last box, number of frames with a box, and
    length of its path in meters."""

    track: str
    category: str
    size_m: list[float]
    t_us: list[int]
    frames: int
    path_m: float


class PlanScores(TypedDict):
    """PDMS, EPDMS and their sub-scores of plans, ``[P]`` each, 0 to 1."""

    no_at_fault_collisions: npt.NDArray[np.float64]
    drivable_area_compliance: npt.NDArray[np.float64]
    driving_direction_compliance: npt.NDArray[np.float64]
    traffic_light_compliance: npt.NDArray[np.float64]
    ego_progress: npt.NDArray[np.float64]
    time_to_collision_within_bound: npt.NDArray[np.float64]
    lane_keeping: npt.NDArray[np.float64]
    history_comfort: npt.NDArray[np.float64]
    comfort: npt.NDArray[np.float64]
    pdms: npt.NDArray[np.float64]
    epdms: npt.NDArray[np.float64]


class _MapKeywords(TypedDict, total=False):
    """Keyword arguments of every function that renders maps, besides augmentation."""

    size: Sequence[int] | None
    splat: str | None
    radius: float
    depth_bins: str
    depth_embedding: str
    far: float | None
    occlusion: str
    template_fit: str
    color_filter: str
    line_width: str
    map_layers: str
    min_actor_points: int
    templates: str | PathLike[str] | None
    default_templates: bool
    rasterizer: str
    device: str | int | None
    gpu_memory: int | None
    memory: int | None
    no_occlusion_culling: bool


class RenderKeywords(_MapKeywords, total=False):
    """Keyword arguments of ``pskel.Renderer`` that datasets of clips pass on."""

    distort: bool


class ExportKeywords(_MapKeywords, total=False):
    """Keyword arguments of ``pskel.export`` besides ``layout``, ``skeletons`` and ``progress``."""

    only: tuple[int, int] | None
    jobs: int
    shard_frames: int
    frames: tuple[int, int] | None
    between_images: bool
    hz: float | None
    images: bool
    verify: bool
    format: str
    color_folder: str
    validation_logs: Sequence[str] | None
    captions: str | PathLike[str] | None
    annotations: str | PathLike[str] | None
    sensor_root: str | PathLike[str] | None
    map_root: str | PathLike[str] | None
    allow_outside: bool
    missing: str
    ring_is: str
    image_distortion: str
    maps: Sequence[str] | None
    out_size: Sequence[int] | None
    augment: int | None
    augment_share: float | None
    augment_color_only: bool


def check_names(given: Mapping[str, object], known: type) -> None:
    """Raise ``TypeError`` for keyword arguments that a ``TypedDict`` does not have."""
    names = sorted(known.__annotations__)
    if unknown := sorted(set(given) - set(names)):
        raise TypeError(f"expected the options {', '.join(names)}, found {', '.join(unknown)}")
