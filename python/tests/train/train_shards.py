"""Exports written by hand, as docs/src/reference/layouts.md says: folders with tar files of samples."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

CAMERAS = ("CAM_FRONT", "CAM_BACK")
SIZE = (6, 10)
ORIGINAL = (60, 100)
FAR_M = 100.0

Array = np.ndarray[Any, Any]

OPTIONS: dict[str, Any] = {
    "export_layout": "webdataset", "format": "png", "images": True, "maps": ["color", "depth", "boxes", "map"],
    "size": "60x100", "out_size": "6x10", "splat": "15:2,35:1,100:0", "radius_m": 100.0, "color_filter": "bilinear",
    "depth_bins": {"count": 256, "far_m": FAR_M, "gamma": 1.0, "scale": "linear"}, "min_actor_points": 20000,
    "template_fit": "box", "layout": {"line_width": "scaled", "map_layers": "lanes"}, "times": "key_frames",
    "color_folder": "proj_clr",
}  # fmt: skip
"""Options in ``export.json`` that matter to readers."""

RECIPE = {
    "drawn": "60x100",
    "size": "6x10",
    "splat": "15:2,35:1,100:0",
    "color_filter": "bilinear",
    "line_width": "scaled",
}
"""The same as a recipe."""


def pose(x: float, y: float, yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]], np.float64)


def ego(t_s: float) -> Array:
    """The ego drives 10 m/s along x and turns 0.1 rad/s."""
    return pose(10 * t_s, 0.0, 0.1 * t_s)


def maps_of(frame: int, camera: int) -> dict[str, Array]:
    """Return the maps and the image of a camera, whose numbers say which frame and camera they are of."""
    random = np.random.default_rng((frame, camera))
    color = random.integers(0, 256, (*SIZE, 3), np.uint8)
    # Depths at the middle of their bins: bin n covers n - 1 to n times far / 255.
    bins = random.integers(0, 256, SIZE).astype(np.int16)
    depth = np.where(bins == 0, -300.0, (bins - 0.5) * (FAR_M / 255)).astype(np.float32)
    image = np.full((*SIZE, 3), 40 + 10 * frame + 3 * camera, np.uint8)
    return {
        "color": color,
        "boxes": random.integers(0, 256, (*SIZE, 3), np.uint8),
        "map": random.integers(0, 256, (*SIZE, 3), np.uint8),
        "bins": bins,
        "depth": depth,
        "image": image,
    }


def _png(array: Array) -> bytes:
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(array).save(content, "PNG")
    return content.getvalue()


def _jpeg(array: Array) -> bytes:
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(array).save(content, "JPEG", quality=95)
    return content.getvalue()


def _npy(array: Array) -> bytes:
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


def _meta(frame: int, interval_us: int, log: str) -> dict[str, Any]:
    t_us = 1_000_000 + frame * interval_us
    cameras = []
    for number, name in enumerate(CAMERAS):
        own_us = t_us + (-20_000, 30_000)[number]
        mounted = np.array([[0, 0, 1, 1.5], [-1, 0, 0, 0.1 * number], [0, -1, 0, 1.6], [0, 0, 0, 1]], np.float64)
        global_from_ego = ego(own_us / 1e6)
        cameras.append({
            "name": name, "height": SIZE[0], "width": SIZE[1], "token": f"token-{frame}-{number}", "t_us": own_us,
            "caption": f"frame {frame} of {name}", "neighbours": [1, number, 1],
            "intrinsics": [[8.0, 0, 5.0], [0, 8.0, 3.0], [0, 0, 1]], "ego_from_camera": mounted.tolist(),
            "global_from_ego": global_from_ego.tolist(), "original_size": list(ORIGINAL),
            "camera_from_global": np.linalg.inv(global_from_ego @ mounted).tolist(),
        })  # fmt: skip
    return {"name": f"{frame:06d}", "log": log, "frame": frame, "t_us": t_us, "fps": 1e6 / interval_us,
            "caption": "", "global_from_ego": ego(t_us / 1e6).tolist(), "cameras": cameras}  # fmt: skip


def write_export(
    folder: Path,
    frames: int = 6,
    *,
    log: str = "2021.05.log",
    per_shard: int = 4,
    options: Mapping[str, Any] | None = None,
    without: Sequence[tuple[int, str]] = (),
    leave_out: Sequence[int] = (),
) -> Path:
    """Write an export, ``without`` some members of frames; ``leave_out`` has the numbers of shards to leave out."""
    from safetensors.numpy import save

    every = {**OPTIONS, **(options or {})}
    (folder / "shards").mkdir(parents=True, exist_ok=True)
    document = {"version": "0.1.0", "records": 3, "options": every}
    (folder / "export.json").write_text(json.dumps(document))
    for shard, first in enumerate(range(0, frames, per_shard)):
        if shard in leave_out:
            continue
        end, name = min(frames, first + per_shard), f"{log}-{first:06d}"
        with tarfile.open(folder / f"{name}.tar", "w", format=tarfile.USTAR_FORMAT) as tar:
            for frame in range(first, end):
                key, maps = f"{log}-{frame:06d}", [maps_of(frame, camera) for camera in range(len(CAMERAS))]
                members = {"json": json.dumps(_meta(frame, 100_000, log)).encode()}
                if every["format"] == "safetensors":
                    arrays = {
                        kind: np.stack([each[kind] for each in maps]) for kind in ("color", "boxes", "map", "depth")
                    }
                    members["conditions.safetensors"] = save(arrays)
                for camera, each in zip(CAMERAS, maps):
                    low = camera.lower()
                    if every["format"] == "png":
                        members |= {f"{kind}.{low}.png": _png(each[kind]) for kind in ("color", "boxes", "map")}
                        members[f"depth.{low}.npy"] = _npy(each["bins"].astype(np.uint16) * 255)
                    members[f"image.{low}.jpg"] = _jpeg(each["image"])
                for member, content in members.items():
                    if (frame, member) in without:
                        continue
                    info = tarfile.TarInfo(f"{key}.{member}")
                    info.size = len(content)
                    tar.addfile(info, io.BytesIO(content))
        record = {"name": name, "log": log, "input": {}, "frames": [first, end], "samples": end - first, "notes": {},
                  "files": [{"path": f"{name}.tar", "bytes": 0, "sha256": ""}]}  # fmt: skip
        (folder / "shards" / f"{name}.json").write_text(json.dumps(record))
    return folder
