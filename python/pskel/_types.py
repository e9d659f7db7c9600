"""Types of results."""

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
