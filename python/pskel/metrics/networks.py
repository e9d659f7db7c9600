"""The networks whose features are compared, loaded when they are first used."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path

import numpy as np

from .cache import FeatureCache
from .i3d import I3D, video_features
from .images import Video
from .inception import image_features, load_inception


class FeatureNetwork:
    """A network with cached features."""

    name: str
    """Part of file names."""
    title: str
    """Name of the distance."""

    def __init__(self, weights: str | os.PathLike[str], cache: Path, device: str) -> None:
        """Use weights, cached features in the folder `cache`, and a device of PyTorch. Raises ValueError if weights are missing."""
        self._weights, self._device = weights, device
        self._cache = FeatureCache(cache, self.name, weights)


class Inception(FeatureNetwork):
    """Inception v3: a feature row per image."""

    name, title = "inception", "FID"

    @cached_property
    def _network(self):  # type: ignore[no-untyped-def]
        return load_inception(self._weights, self._device)

    def features(self, video: Video) -> np.ndarray:
        """Return features [T, 2048], float32."""
        return self._cache.get(video, range(len(video)), 1, lambda: image_features(self._network, video.read()))


class Video3d(FeatureNetwork):
    """I3D: a feature row per clip."""

    name, title = "i3d", "FVD"

    @cached_property
    def _network(self) -> I3D:
        return I3D.load(self._weights, self._device)

    def features(self, video: Video, starts: range, frames: int) -> np.ndarray:
        """Return features [N, 400], float32, of the clips of `frames` frames that begin at `starts`."""

        def compute() -> np.ndarray:
            images = video.read()
            return video_features(self._network, [images[start : start + frames] for start in starts])

        return self._cache.get(video, starts, frames, compute)
