"""Recorded drives to camera conditions: colored point skeletons splatted into six cameras by headless Vulkan."""

from ._pskel import BuildError, Error, Log, LogError, Renderer, RenderError, Skeleton, State, build, splat

__all__ = ["BuildError", "Error", "Log", "LogError", "RenderError", "Renderer", "Skeleton", "State", "build", "splat"]
