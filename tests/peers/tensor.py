"""Generates tensor.json: model tensors of a small image by NumPy, the reference for src/conditions/tensor.rs.

Run: python3 tests/peers/tensor.py  (numpy 2.4)
"""

import json
import pathlib

import numpy as np

f32 = np.float32
HEIGHT, WIDTH, N = 5, 6, 256


def linear(depth, far):
    clipped = np.clip(depth, f32(0), far)
    return np.trunc(clipped / (far + f32(1e-6)) * f32(N - 1)).astype(np.int64) + 1


def log(depth, far):
    near, n1 = f32(0.6) * far, min(round(0.85 * N), N - 1)
    clipped = np.clip(depth, f32(0), far)
    low = np.trunc(np.log1p(clipped) / (np.log1p(near) + f32(1e-6)) * f32(n1 - 1)).astype(np.int64) + 1
    over = np.maximum(clipped - near, f32(0))
    high = np.trunc(np.log1p(over) / (np.log1p(far - near) + f32(1e-6)) * f32(N - n1 - 1)).astype(np.int64) + 1 + n1
    return np.where(clipped <= near, low, high)


def points(color, depth, bins):
    """[20, H, W]: rgb / 255, u, sin, cos; all in f32."""
    empty = depth < 0
    u = (np.minimum(bins, N - 1).astype(f32) / f32(N - 1)).astype(f32)
    k = np.arange(8, dtype=f32)
    frequencies = np.exp2(k * np.log2(f32(N / 2)) / f32(7)).astype(f32)
    phase = (f32(2 * np.pi) * u)[None] * frequencies[:, None, None]
    assert phase.dtype == f32
    waves = np.where(empty, f32(0), np.concatenate([np.sin(phase), np.cos(phase)]))
    rgb = color.transpose(2, 0, 1).astype(f32) / f32(255)
    return np.concatenate([rgb, np.where(empty, f32(-1), u)[None], waves]).astype(f32)


def layout(boxes, hd_map):
    return np.concatenate([boxes, hd_map], axis=2).transpose(2, 0, 1).astype(f32) / f32(255)


rng = np.random.default_rng(20)
color, boxes, hd_map = rng.integers(0, 256, (3, HEIGHT, WIDTH, 3), dtype=np.uint8)
depth = np.exp(rng.uniform(np.log(0.3), np.log(130), (HEIGHT, WIDTH))).astype(f32)
depth[rng.random((HEIGHT, WIDTH)) < 0.2] = -300  # empty
depth[0, 0], depth[0, 1], depth[0, 2] = 100, 1e-3, 60
cases = []
for scale, to_bins, far in [("linear", linear, 50), ("log", log, 100)]:
    bins = np.where(depth < 0, 0, to_bins(depth, f32(far)))
    cases.append({"scale": scale, "far_m": far, "bins": bins.ravel().tolist(), "points": points(color, depth, bins).ravel().tolist()})
out = {
    "size": [HEIGHT, WIDTH],
    "color": color.ravel().tolist(),
    "depth": depth.ravel().tolist(),
    "boxes": boxes.ravel().tolist(),
    "map": hd_map.ravel().tolist(),
    "layout": layout(boxes, hd_map).ravel().tolist(),
    "cases": cases,
}
path = pathlib.Path(__file__).with_name("tensor.json")
path.write_text(json.dumps(out, separators=(",", ":")) + "\n")
