"""Recorded drives to camera conditions: colored point skeletons splatted into six cameras by headless Vulkan."""

from ._pskel import (
    Actor,
    BuildError,
    Camera,
    Committed,
    Error,
    Forecast,
    Frames,
    Log,
    LogError,
    Renderer,
    RenderError,
    ResetAndRoll,
    Scene,
    Simulation,
    SimulationError,
    Skeleton,
    __version__,
    splat,
)
from ._build import build
from ._export import ExportReport, export
from ._types import Maps

__all__ = [
    "Actor",
    "BuildError",
    "Camera",
    "Committed",
    "Error",
    "ExportReport",
    "Forecast",
    "Frames",
    "Log",
    "LogError",
    "Maps",
    "RenderError",
    "Renderer",
    "ResetAndRoll",
    "Scene",
    "Simulation",
    "SimulationError",
    "Skeleton",
    "__version__",
    "build",
    "export",
    "splat",
]
