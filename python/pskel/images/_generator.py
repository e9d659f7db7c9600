"""What a generator implements and what it is asked, and checks of both."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .._messages import MAX_ANSWER_BYTES

__all__ = ["MAPS", "MAX_COUNT", "ImageGenerator", "ImageRequest", "RequestActor", "Settings"]

#: Maps that a generator can ask for.
MAPS = ("color", "depth", "class", "instance", "boxes", "map")
#: Maximum of references, earlier images and forecasts.
MAX_COUNT = 100
_HEADER_BYTES = 1 << 16


class RequestActor(NamedTuple):
    """Actor of a frame; actor ``i`` has the value ``i + 1`` in the map ``instance``."""

    track: str
    category: str
    """Category of the data set, such as ``vehicle.car``."""
    class_name: str
    """``motor_vehicle``, ``pedestrian``, ``cycle`` or ``object``."""
    size: tuple[float, float, float]
    """Length, width, height in meters."""
    global_from_box: npt.NDArray[np.float64]
    """``[4, 4]``: box axes are forward, left, up, from the center of the box."""


@dataclass(frozen=True)
class ImageRequest:
    """Conditions of a planning step and of forecasts, and the earlier images.

    Frame 0 of N is the committed planning step; the others are forecasts of the next ones, which are never committed.
    V is the number of cameras.
    """

    frame: int
    """Number of the planning step since the start."""
    t_us: list[int]
    """Times of the N frames, absolute microseconds."""
    prompts: list[str | list[str]]
    """A text for each of the N frames, empty without captions, or a list of V captions."""
    actors: list[list[RequestActor]]
    """Actors of the N frames."""
    maps: dict[str, npt.NDArray[Any]]
    """The maps that the generator wants. ``color``, ``boxes``, ``map``: ``uint8 [N, V, H, W, 3]``; ``depth``: ``float32
    [N, V, H, W]``, meters along the optical axis, ``inf`` where empty; ``class``: ``uint8``, ``instance``: ``uint16
    [N, V, H, W]``, 0 where empty."""
    global_from_ego: npt.NDArray[np.float64]
    """``[N, 4, 4]``, meters."""
    ego_from_camera: npt.NDArray[np.float64]
    """``[N, V, 4, 4]``, meters; camera axes are right, down, forward."""
    intrinsics: npt.NDArray[np.float64]
    """``[N, V, 3, 3]``, in pixels of the maps."""
    images: npt.NDArray[np.uint8]
    """The P earlier images ``[P, V, h, w, 3]``, oldest first: recorded ones, then those of the generator. P is the smaller
    of ``history`` and ``frame``."""
    cameras: tuple[str, ...]
    """Names of the V cameras."""


class ImageGenerator(ABC):
    """Makes the camera images of a rollout.

    Its images may depend on nothing but the hello and the request: a rollout that was interrupted is then resumed with the
    same images. The attributes are read once, before the first request.
    """

    image_size: tuple[int, int]
    """Height and width of its images, pixels."""
    maps: Sequence[str] = ("color",)
    """The maps it wants: ``color``, ``depth``, ``class``, ``instance``, ``boxes``, ``map``."""
    references: int = 1
    """Number of recorded images at the beginning of a rollout, 0 to 100. These planning steps are not asked for."""
    history: int | None = None
    """Number of earlier images in a request, 0 to 100; by default ``references``."""
    forecasts: int = 0
    """Number of forecasts in a request, at most, 0 to 100: there are fewer where the plan of the ego or the log ends."""

    @abstractmethod
    def generate(self, request: ImageRequest) -> npt.NDArray[np.uint8]:
        """Return the images of all cameras at frame 0, RGB, ``uint8 [V, h, w, 3]``; ``image_size`` is (h, w)."""


class Settings(NamedTuple):
    """Checked attributes of a generator."""

    size: tuple[int, int]
    maps: tuple[str, ...]
    references: int
    history: int
    forecasts: int
    views: int

    @classmethod
    def of(cls, generator: ImageGenerator, views: int, known: Sequence[str]) -> Settings:
        """Read the attributes of a generator; raises ``ValueError`` for wrong ones, and for maps that are not ``known``."""
        found: Any = getattr(generator, "image_size", None)
        size = tuple(found) if isinstance(found, (tuple, list)) else ()
        if len(size) != 2 or not all(_is_whole(side) and side > 0 for side in size):
            raise ValueError(f"expected image_size of a generator as (height, width), found {found!r}")
        height, width = (int(side) for side in size)
        if (image_bytes := views * height * width * 3) > MAX_ANSWER_BYTES - _HEADER_BYTES:
            raise ValueError(f"expected images of at most {MAX_ANSWER_BYTES} bytes, found {views} of {height}x{width}: {image_bytes} bytes")
        maps = (generator.maps,) if isinstance(generator.maps, str) else tuple(generator.maps)
        if any(name not in known for name in maps) or len(set(maps)) < len(maps):
            raise ValueError(f"expected maps of a generator among {', '.join(known)}, found {', '.join(map(str, maps))}")
        history = generator.references if generator.history is None else generator.history
        counts = {"references": generator.references, "history": history, "forecasts": generator.forecasts}
        for name, count in counts.items():
            if not _is_whole(count) or not 0 <= count <= MAX_COUNT:
                raise ValueError(f"expected {name} of a generator as a number from 0 to {MAX_COUNT}, found {count!r}")
        return cls((height, width), maps, int(generator.references), int(history), int(generator.forecasts), views)

    def checked(self, images: Any) -> npt.NDArray[np.uint8]:
        """Return the images of a generator; raises ``ValueError`` for another shape, another type, and masked values."""
        shape = (self.views, *self.size, 3)
        if np.ma.isMaskedArray(images):
            raise ValueError("expected images without masked values, found a masked array")
        array = np.asarray(images)
        if array.dtype != np.uint8 or array.shape != shape:
            raise ValueError(f"expected images uint8 {list(shape)} of the generator, found {array.dtype} {list(array.shape)}")
        return np.ascontiguousarray(array)


def _is_whole(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)
