"""Generates quality.json: metrics of images by NumPy, SciPy and OpenCV, the references for src/metrics.

Run: python3 tests/peers/quality.py  (numpy 2.4, scipy 1.17, opencv-python 5.0)
"""

import json
import pathlib

import cv2
import numpy as np
from scipy.signal import convolve2d
from scipy.stats import t as student_t


def levels(count, start, step=1):
    """Returns the same numbers as the test: a mixed linear congruence per level."""
    n = np.arange(count, dtype=np.uint64) * step + start
    return ((n * 2654435761 + 12345) % (1 << 32) >> 13) % 256


def image(height, width, start, smooth):
    """Returns noise, mixed with a ramp if `smooth` is positive."""
    v = levels(height * width * 3, start).reshape(height, width, 3)
    y, x, c = np.meshgrid(np.arange(height), np.arange(width), np.arange(3), indexing="ij")
    ramp = (5 * y + 3 * x + 40 * c) % 256
    return ((v + smooth * ramp) // (1 + smooth)).astype(np.uint8)


def psnr(a, b):
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b.astype(float)) ** 2))


def ssim(a, b):
    off = np.arange(11) - 5
    w = np.exp(-off**2 / (2 * 1.5**2))
    w = np.outer(w, w) / w.sum() ** 2
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    blur = lambda p: convolve2d(p, w, mode="valid")
    means = []
    for c in range(3):
        x, y = a[..., c].astype(float), b[..., c].astype(float)
        mx, my = blur(x), blur(y)
        vx, vy, vxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
        s = (2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
        means.append(s.mean())
    return np.mean(means)


def sharpness(a):
    luma = a.astype(float) @ [0.299, 0.587, 0.114]
    dx, dy = luma[:-1, 1:] - luma[:-1, :-1], luma[1:, :-1] - luma[:-1, :-1]
    return np.hypot(dx, dy).mean()


images = []
for h, w, start, other, smooth in [(32, 56, 0, 7, 9), (32, 56, 3, 5, 2), (11, 11, 1, 2, 4), (17, 40, 0, 9, 30)]:
    a, b = image(h, w, start, smooth), image(h, w, other, smooth)
    images.append({
        "size": [h, w], "starts": [start, other], "smooth": smooth,
        "psnr_db": psnr(a, b), "ssim": ssim(a, b), "sharpness": sharpness(a),
    })
masks = []
for h, w in [(12, 20), (5, 7), (1, 6), (6, 1)]:
    mask = (levels(h * w, 4) > 190).astype(np.uint8).reshape(h, w)
    # OpenCV restricts both steps to the image; with pixels around it, the closing is that of an unbounded mask.
    closed = cv2.morphologyEx(np.pad(mask, 2), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))[2:-2, 2:-2]
    blurred = cv2.GaussianBlur(255 * mask, (3, 3), 0) > 127
    lists = {"class": mask, "closed": closed, "blurred": blurred.astype(int)}
    masks.append({"size": [h, w], **{name: each.ravel().tolist() for name, each in lists.items()}})
t = {str(n): float(student_t.ppf(0.975, n)) for n in [1, 2, 7, 30, 31, 45, 300]}
out = {"images": images, "masks": masks, "student_t": t}
path = pathlib.Path(__file__).with_name("quality.json")
path.write_text(json.dumps(out, separators=(",", ":")) + "\n")
