"""Cameras and images of a rollout for a driver."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from pskel.alpasim import sensorsim_pb2
from pskel.alpasim.pinhole import pinhole

from .driver import DriverError, one_line

#: Nearest cameras of AlpaSim's vehicles to those of nuScenes and the town, nuPlan, Argoverse 2, and 123D (its own vehicles, and others;
#: of several the first that a rollout has).
ALPASIM_NAMES = {
    "camera_front_wide_120fov": ("CAM_FRONT", "CAM_F0", "ring_front_center", "FTCAM_F0", "PCAM_F0"),
    "camera_front_tele_30fov": ("FTCAM_TELE_F0",),
    "camera_cross_left_120fov": ("CAM_FRONT_LEFT", "CAM_L0", "ring_front_left", "FTCAM_L0", "PCAM_L0"),
    "camera_cross_right_120fov": ("CAM_FRONT_RIGHT", "CAM_R0", "ring_front_right", "FTCAM_R0", "PCAM_R0"),
    "camera_rear_left_70fov": ("CAM_BACK_LEFT", "CAM_L2", "ring_rear_left", "FTCAM_L1", "PCAM_L2", "PCAM_L1"),
    "camera_rear_right_70fov": ("CAM_BACK_RIGHT", "CAM_R2", "ring_rear_right", "FTCAM_R1", "PCAM_R2", "PCAM_R1"),
    "camera_rear_tele_30fov": ("CAM_BACK", "CAM_B0", "FTCAM_TELE_B0", "PCAM_B0"),
}
_PNG = b"\x89PNG\r\n\x1a\n"


def logical_ids(choice: str, names: list[str]) -> dict[str, str]:
    """Return the driver's name of each camera that it receives, by the name in the rollout.

    ``choice`` is ``all`` (own names), ``alpasim`` (the nearest cameras of AlpaSim's vehicles), or a list
    ``CAM=ID,..`` or ``CAM,..``. ``names`` are the rollout's cameras. Raises ``DriverError`` for cameras that
    the rollout lacks, and for an ID of two cameras.
    """
    if choice == "all":
        return {name: name for name in names}
    if choice == "alpasim":
        nearest = {logical: [name for name in others if name in names] for logical, others in ALPASIM_NAMES.items()}
        first = {found[0]: logical for logical, found in nearest.items() if found}
        ids = {name: first[name] for name in names if name in first}
    else:
        pairs = [part.partition("=") for part in choice.split(",")]
        ids = {name: logical or name for name, _, logical in pairs}
        if len(ids) < len(pairs):
            raise DriverError(f"expected each camera once, found {choice!r}")
    unknown = [name for name in ids if name not in names]
    if not ids or unknown or len(set(ids.values())) < len(ids):
        raise DriverError(f"expected cameras among {', '.join(names)} with different IDs, found {choice!r}")
    return ids


class Images:
    """Images of a rollout's steps.

    ``kind`` is a map (``color``, ``class``, ..), ``generated`` or ``truth``; ``auto`` is ``generated`` if the first step has generated
    images, else ``color``. ``encoding`` is ``png`` (the files as they are) or ``jpeg`` (quality 95; needs Pillow).
    """

    def __init__(self, kind: str, encoding: str) -> None:
        self._kind = kind
        self._encoding = encoding

    def read(self, step: Path, camera: str) -> bytes:
        """Return the encoded image of a camera in the folder of a step. Raises ``DriverError`` if there is none."""
        data = self.png(step, camera)
        return data if self._encoding == "png" else _jpeg(data)

    def png(self, step: Path, camera: str) -> bytes:
        """Return the file of the image, a PNG."""
        if self._kind == "auto":
            self._kind = "generated" if (step / "generated").is_dir() else "color"
        path = step / self._kind / f"{camera}.png" if self._kind in _REASONS else step / camera / f"{self._kind}.png"
        try:
            data = path.read_bytes()
        except OSError as error:
            reason = _REASONS.get(self._kind, "maps are images with --format png, and those of --maps")
            raise DriverError(f"expected {path}, found {error.strerror} ({reason})") from None
        if not data.startswith(_PNG) or len(data) < 24:
            raise DriverError(f"expected a PNG image, found {data[:8]!r} in {path}")
        return data


_REASONS = {
    "generated": "generated images need --generator",
    "truth": "ground truth needs --generator; a recorded log has it while ego and actors follow the log",
}


def size(image: bytes) -> tuple[int, int]:
    """Return width and height of a PNG image, pixels."""
    width, height = struct.unpack(">II", image[16:24])
    return width, height


def _jpeg(png: bytes) -> bytes:
    try:
        from PIL import Image
    except ImportError:
        raise DriverError("expected Pillow for JPEG images, found none: pip install 'pskel[alpasim]'") from None
    out = io.BytesIO()
    with Image.open(io.BytesIO(png)) as image:
        image.convert("RGB").save(out, format="JPEG", quality=95)
    return out.getvalue()


def rig(step: Path) -> list[Any]:
    """Return the cameras in the ``meta.json`` of a step. Raises ``DriverError`` if there are none."""
    path = step / "meta.json"
    try:
        cameras = json.loads(path.read_bytes())["cameras"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DriverError(f"expected cameras in {path}, found {one_line(str(error))}") from None
    if not isinstance(cameras, list) or not cameras:
        raise DriverError(f"expected cameras in {path}, found none")
    return cameras


def available(step: Path, ids: dict[str, str], images: Images) -> list[sensorsim_pb2.AvailableCamerasReturn.AvailableCamera]:
    """Return the cameras of ``ids`` as a driver knows them, with the size of their images in the folder of a step.

    They are pinhole cameras without distortion.
    """
    cameras = []
    for camera in rig(step):
        if camera["name"] not in ids:
            continue
        width, height = size(images.png(step, camera["name"]))
        scale = np.array([[width / camera["width"]], [height / camera["height"]], [1.0]])
        intrinsics = np.array(camera["intrinsics"], dtype=np.float64) * scale
        mount = np.array(camera["ego_from_camera"], dtype=np.float64).reshape(4, 4)
        cameras.append(pinhole(ids[camera["name"]], intrinsics, (height, width), mount))
    return cameras
