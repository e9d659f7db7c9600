"""Features of Inception and I3D, for the FID and FVD of generated rollouts (docs/src/guide/evaluation.md)."""

from .frechet import frechet_distance
from .i3d import I3D, video_features
from .images import GeneratedVideo, Video, read_reference, read_rollout
from .inception import image_features, load_inception

__all__ = [
    "I3D",
    "GeneratedVideo",
    "Video",
    "frechet_distance",
    "image_features",
    "load_inception",
    "read_reference",
    "read_rollout",
    "video_features",
]
