"""Decoding and reduction of image files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..errors import DataError, first_line

__all__ = ["gray16_of", "pillow", "reduced", "rgb_of", "rgb_tensor"]


def pillow() -> Any:
    """Import Pillow's ``Image``. Raises ``DataError`` if it is not installed."""
    try:
        from PIL import Image
    except ImportError:
        raise DataError("reading image files needs Pillow: pip install 'pskel[train]'") from None
    return Image


def rgb_of(content: bytes, source: str, size: tuple[int, int] | None = None) -> npt.NDArray[np.uint8]:
    """Decode an image to ``uint8 [H, W, 3]``; one of another size than (height, width) is reduced to it.

    Raises ``DataError``, which names ``source``.
    """
    Image = pillow()
    try:
        with Image.open(io.BytesIO(content)) as image:
            found = image.convert("RGB")
    except Exception as error:  # of many kinds, by the format of the file
        raise DataError(f"expected an image, found {first_line(error)}: {source}") from None
    if size is not None and found.size != (size[1], size[0]):
        found = found.resize((size[1], size[0]), Image.Resampling.BILINEAR)
    return np.asarray(found, np.uint8)


def gray16_of(content: bytes, source: str) -> npt.NDArray[np.int32]:
    """Decode a gray PNG of 16 bits to ``int32 [H, W]``. Raises ``DataError`` for another image."""
    Image = pillow()
    try:
        with Image.open(io.BytesIO(content)) as image:
            mode, values = image.mode, np.asarray(image)
    except Exception as error:  # of many kinds, by the format of the file
        raise DataError(f"expected an image, found {first_line(error)}: {source}") from None
    if mode not in ("I", "I;16", "I;16B"):
        raise DataError(f"expected a gray image of 16 bits, found mode {mode}: {source}")
    return values.astype(np.int32)


def reduced(images: npt.NDArray[np.uint8], size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Reduce ``uint8 [V, H, W, 3]`` to a size (height, width) by a triangle filter."""
    if images.shape[1:3] == size:
        return images
    Image = pillow()
    bilinear = Image.Resampling.BILINEAR
    return np.stack([np.asarray(Image.fromarray(image).resize((size[1], size[0]), bilinear)) for image in images])


def rgb_tensor(images: Sequence[Sequence[npt.NDArray[np.uint8]] | npt.NDArray[np.uint8]]) -> Tensor:
    """Return images ``[L][V]`` of ``[H, W, 3]``, or ``[L]`` of ``[V, H, W, 3]``, as ``uint8 [L, V, 3, H, W]``."""
    stacked = np.stack([np.asarray(row) for row in images])
    return torch.from_numpy(np.ascontiguousarray(stacked.transpose(0, 1, 4, 2, 3)))
