"""Encoded images."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pskel.alpasim import sensorsim_pb2

from .errors import invalid

#: Quality of JPEG images if a request has none; that of AlpaSim.
QUALITY = 95


def encoded(image: NDArray[Any], image_format: int, quality: float) -> bytes:
    """Return a color image ``uint8 [H, W, 3]`` as PNG or JPEG. Raises ``RequestError`` for other formats and wrong qualities."""
    from PIL import Image

    out = io.BytesIO()
    picture = Image.fromarray(np.ascontiguousarray(image))
    if image_format == sensorsim_pb2.PNG:
        picture.save(out, format="PNG", compress_level=1)
    else:
        picture.save(out, format="JPEG", quality=round(quality) or QUALITY)
    return out.getvalue()


def check(image_format: int, quality: float) -> None:
    """Raise ``RequestError`` for a format other than PNG and JPEG, and for a quality that is not 0 (default) to 100."""
    if image_format not in (sensorsim_pb2.PNG, sensorsim_pb2.JPEG):
        known = sensorsim_pb2.ImageFormat.items()
        names = {number: name for name, number in known}
        raise invalid("image_format PNG or JPEG", names.get(image_format, image_format))
    if not 0.0 <= quality <= 100.0:
        raise invalid("image_quality of 0 to 100", quality)
