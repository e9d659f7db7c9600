"""FID and FVD of sets of videos, as a whole and over the horizon."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .frechet import frechet_distance
from .images import Video
from .networks import Inception, Video3d

FeatureSets = dict[str, list[np.ndarray]]
"""Features by the kind of images (generated, and truth or reference), one array per video."""


class TooShortError(ValueError):
    """No video has the frames of a clip."""


@dataclass(frozen=True)
class Comparison:
    """Features of generated and other images."""

    sets: FeatureSets
    """By kind: first generated, then truth or reference."""
    starts: list[range]
    """First frames of the clips of each generated video."""
    frames: int
    """Frames of a window or clip."""

    @cached_property
    def whole(self) -> dict[str, np.ndarray]:
        """Features of all videos, by kind."""
        return {kind: np.concatenate(features) for kind, features in self.sets.items()}

    def distance(self) -> dict[str, object]:
        """Return the distance of all features, and the sizes of both sets."""
        generated, other = self.whole.values()
        samples = [len(generated), len(other)]
        return {"distance": frechet_distance(generated, other), "samples": samples, "features": generated.shape[1]}


class ImageComparison(Comparison):
    """A feature row per image."""

    def curve(self) -> dict[int, float]:
        """Return the distance over the images of each frame window, by its first frame.

        A window of generated images is compared with the ground truth at the same frames, or with all reference
        images.
        """
        generated, truth = self.sets["generated"], self.sets.get("truth")
        starts = range(max(len(features) for features in generated) - self.frames + 1)

        def window(features: list[np.ndarray], start: int) -> np.ndarray:
            return np.concatenate([each[start : start + self.frames] for each in features])

        def other(start: int) -> np.ndarray:
            return self.whole["reference"] if truth is None else window(truth, start)

        return {start: frechet_distance(window(generated, start), other(start)) for start in starts}


class ClipComparison(Comparison):
    """A feature row per clip."""

    def curve(self) -> dict[int, float]:
        """Return the distance over the clips that begin at the same frame, by that frame, where there are two or more.

        They are compared with the ground truth of the same frames, or with all reference clips.
        """
        generated, truth = self.sets["generated"], self.sets.get("truth")
        curve = {}
        for start in sorted({start for some in self.starts for start in some}):
            which = [(number, some.index(start)) for number, some in enumerate(self.starts) if start in some]
            if len(which) > 1:
                clips = np.stack([generated[number][row] for number, row in which])
                others = self.whole["reference"] if truth is None else np.stack([truth[number][row] for number, row in which])
                curve[start] = frechet_distance(clips, others)
        return curve


def compare_images(network: Inception, videos: dict[str, list[Video]], frames: int) -> ImageComparison:
    """Compute the features of all images, by kind. `frames` is the length of a window."""
    sets = {kind: [network.features(video) for video in some] for kind, some in videos.items()}
    return ImageComparison(sets, [], frames)


def compare_clips(network: Video3d, videos: dict[str, list[Video]], frames: int, stride: int) -> ClipComparison:
    """Compute the features of all clips of `frames` frames, one every `stride` frames.

    Raises TooShortError if no generated, or no other video has a clip.
    """

    def starts(video: Video) -> range:
        return range(0, len(video) - frames + 1, stride)

    for kind, some in videos.items():
        longest = max(len(video) for video in some)
        if longest < frames:
            raise TooShortError(f"expected a rollout of {frames} {kind} frames or more, found at most {longest}")
    sets = {kind: [network.features(video, starts(video), frames) for video in some] for kind, some in videos.items()}
    return ClipComparison(sets, [starts(video) for video in videos["generated"]], frames)


def shorter(videos: list[Video], frames: int) -> str | None:
    """Return a note if some videos have no clip."""
    count = sum(len(video) < frames for video in videos)
    return f"{count} of {len(videos)} videos have fewer than {frames} frames and no part in FVD" if count else None
