"""Generates resize.json: small images resized by OpenCV and Pillow, the references for src/conditions/reduce.rs.

Run: python3 tests/peers/resize.py  (opencv-python 5.0, Pillow 13.0, numpy 2.4)
"""

import json
import pathlib

import cv2
import numpy as np
from PIL import Image

SIZES = [  # height, width -> height, width
    (45, 80, 13, 22),
    (54, 96, 11, 22),
    (20, 30, 10, 15),
    (17, 9, 17, 9),
    (5, 1, 3, 1),
    (7, 1600, 2, 448),
]


def image(height, width):
    """Returns the same image as the test: a mixed linear congruence per level, with black holes."""
    n = np.arange(height * width * 3, dtype=np.uint64)
    v = (n * 2654435761 + 12345) % (1 << 32)
    v = (v >> 13) % 256
    pixel = n // 3
    return np.where(pixel % 7 == 0, 0, v).astype(np.uint8).reshape(height, width, 3)


cases = []
for h, w, oh, ow in SIZES:
    src = image(h, w)
    cases.append({
        "from": [h, w],
        "to": [oh, ow],
        "nearest": cv2.resize(src, (ow, oh), interpolation=cv2.INTER_NEAREST).ravel().tolist(),
        "linear": cv2.resize(src, (ow, oh), interpolation=cv2.INTER_LINEAR).ravel().tolist(),
        "pil": np.asarray(Image.fromarray(src).resize((ow, oh), Image.BILINEAR)).ravel().tolist(),
    })
columns = cv2.resize(np.arange(1600, dtype=np.uint16)[None], (448, 1), interpolation=cv2.INTER_NEAREST)
out = {"cases": cases, "nearest_1600_448": columns.ravel().tolist()}
path = pathlib.Path(__file__).with_name("resize.json")
path.write_text(json.dumps(out, separators=(",", ":")) + "\n")
