"""Recorded drives to camera conditions: colored point skeletons splatted into six cameras by headless Vulkan."""

from typing import TYPE_CHECKING, Any

from .images import ImageGenerator, ImageRequest

try:
    from ._pskel import (
        Actor,
        BuildError,
        Camera,
        Captions,
        Committed,
        Error,
        Forecast,
        Frames,
        Generator,
        Log,
        LogError,
        RenderError,
        ResetAndRoll,
        Scene,
        SimulationError,
        Skeleton,
        __version__,
        fill_holes,
        lidar_spec,
        score_plans,
        splat,
    )
    from ._build import build
    from ._drive import Drive, drive
    from ._export import ExportReport, export
    from ._renderer import Renderer
    from ._simulation import Simulation
    from ._types import LidarSweep, Maps, PlanScores, Track
except ModuleNotFoundError as error:
    if error.name != "pskel._pskel":
        raise

    if not TYPE_CHECKING:
        # A source tree: planners of other programs run without the compiled part, in environments of their own.
        def __getattr__(name: str) -> Any:
            raise AttributeError(f"expected the compiled part of pskel for pskel.{name}, found none; ci/wheel.sh builds a wheel")


__all__ = [
    "Actor",
    "BuildError",
    "Camera",
    "Captions",
    "Committed",
    "Drive",
    "Error",
    "ExportReport",
    "Forecast",
    "Frames",
    "Generator",
    "ImageGenerator",
    "ImageRequest",
    "LidarSweep",
    "Log",
    "LogError",
    "Maps",
    "PlanScores",
    "RenderError",
    "Renderer",
    "ResetAndRoll",
    "Scene",
    "Simulation",
    "SimulationError",
    "Skeleton",
    "Track",
    "__version__",
    "build",
    "drive",
    "export",
    "fill_holes",
    "lidar_spec",
    "score_plans",
    "splat",
]
