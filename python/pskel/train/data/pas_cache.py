"""Maps of the layout pas-cache, for logs that have the images and the poses.

``FOLDER/3dbox_images`` and ``hdmap_images`` are as large as the images, ``proj_depth_g1.0`` (nuPlan:
``proj_depth_g1.0_b256``) and ``proj_clr`` as large as the maps. Files are named by image tokens.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DataError
from .exports import export_options
from .images import gray16_of, rgb_of
from .logs import LogMaps, LogReader
from .reader import Skip
from .recipe import BINS, of_export, size_of

if TYPE_CHECKING:
    import pskel

__all__ = ["PasCacheReader", "recipe_of_cache"]

_DEPTHS = ("proj_depth_g1.0", "proj_depth_g1.0_b256")


def recipe_of_cache(folder: Path) -> dict[str, Any]:
    """Return the recipe of a cache. Raises ``DataError`` for an export in another layout, or one without a size."""
    options = export_options(folder)
    if options["export_layout"] != "pas-cache":
        raise DataError(f"expected an export in the layout pas-cache, found {options['export_layout']}: {folder}")
    text = options.get("out_size") or options.get("size")
    if text is None:
        raise DataError(f"expected a cache with --out-size, found one at the cameras' own sizes: {folder}")
    return of_export({**options, "depth_bins": {**BINS, **options["depth_bins"]}}, size_of(text, "out_size"))


class PasCacheReader(LogReader):
    """A log whose maps are read from a cache; nothing is rendered but images of a town."""

    def __init__(
        self, text: str, folder: str | os.PathLike[str], recipe: Mapping[str, Any], captions: str | None
    ) -> None:
        super().__init__(text, recipe, captions)
        self.folder = Path(folder)
        self.source = f"{folder} ({text})"
        options = export_options(self.folder)
        self._color = self.folder / str(options["color_folder"])
        depths = [self.folder / name for name in _DEPTHS if (self.folder / name).is_dir()]
        if len(depths) != 1 or not self._color.is_dir():
            raise DataError(f"expected the folders {self._color.name} and {_DEPTHS[0]}, found others: {self.folder}")
        self._depth = depths[0]
        self._has_map = (self.folder / "hdmap_images").is_dir()
        self._tokens = self.opened_log().image_tokens

    def _read(self, folder: Path, frame: int, camera: str) -> tuple[bytes, str]:
        """Return the content and the path of an image's file."""
        path = folder / f"{self._tokens[frame].get(camera)}.png"
        try:
            return path.read_bytes(), os.fspath(path)
        except FileNotFoundError:
            raise Skip(f"clips with images that are not in the cache, such as {path}") from None
        except OSError as error:
            raise DataError(f"the cache cannot be read: {error.strerror}: {path}") from error

    def maps(self, scene: pskel.Scene, frame: int) -> LogMaps:
        """Read the maps of a frame; boxes and map are reduced to the size of the others."""
        size = size_of(self.recipe["size"], "recipe.size")
        step = 65535 // int(self.recipe["bins"]["count"])
        color, bins, boxes, maps = [], [], [], []
        for camera in self.names:
            content, source = self._read(self._color, frame, camera)
            color.append(rgb_of(content, source))
            bins.append((gray16_of(*self._read(self._depth, frame, camera)) // step).astype(np.int16))
            if color[-1].shape[:2] != size or bins[-1].shape != size:
                found = "x".join(map(str, color[-1].shape[:2]))
                raise DataError(f"expected maps of {self.recipe['size']}, found color of {found}: {source}")
            boxes.append(rgb_of(*self._read(self.folder / "3dbox_images", frame, camera), size))
            black = np.zeros((*size, 3), np.uint8)
            map_ = rgb_of(*self._read(self.folder / "hdmap_images", frame, camera), size) if self._has_map else black
            maps.append(map_)
        return LogMaps(np.stack(color), np.stack(bins), np.stack(boxes), np.stack(maps))
