"""Conditions and loops of training and inference: ``--recipe pas-image-nuscenes`` and ``pas-image-nuplan``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

__all__ = ["PRESETS", "Preset"]


class Preset(NamedTuple):
    """How maps are rendered, and the numbers of the loop."""

    recipe: Mapping[str, Any]
    """Keys of a recipe of the denoiser protocol."""
    window: int = 2
    steps: int = 20
    guidance: float = 2.0
    sampler: str = "ddim_epsilon"
    fps: float = 2.0
    """Frames per second."""


_SHARED = {
    "size": "224x400",
    "radius_m": 100.0,
    "color_filter": "bilinear",
    "bins": {"far_m": 100.0},
    "template_fit": "none",
    "line_width": "scaled",
}
"""The paper's radius is 100 m; all else is as for the video network."""

PRESETS: Mapping[str, Preset] = {
    "pas-image-nuscenes": Preset({**_SHARED, "drawn": "900x1600", "splat": "15:2,35:1,100:0"}),
    "pas-image-nuplan": Preset({**_SHARED, "drawn": "1080x1920", "splat": "25:1,50:0", "map_layers": "dividers"}),
}
"""Values for the data sets of the paper. Frames come at 2 Hz on nuScenes; nuPlan's rate is not published."""
