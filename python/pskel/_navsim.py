"""Shared by agents and scenes of NAVSIM: frames, cameras, ego states."""

from __future__ import annotations

import json
import math
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from pskel._planner import Message, PlannerError

#: Time between frames, seconds, and number of frames that an agent sees.
FRAME_S = 0.5
FRAMES = 4
#: Cameras, each with those of nuPlan, of nuScenes and the town, and of 123D, that it stands for.
CAMERAS = {
    "cam_f0": ("CAM_F0", "CAM_FRONT", "PCAM_F0"),
    "cam_l0": ("CAM_L0", "CAM_FRONT_LEFT", "PCAM_L0"),
    "cam_l1": ("CAM_L1", "PCAM_L1"),
    "cam_l2": ("CAM_L2", "CAM_BACK_LEFT", "PCAM_L2"),
    "cam_r0": ("CAM_R0", "CAM_FRONT_RIGHT", "PCAM_R0"),
    "cam_r1": ("CAM_R1", "PCAM_R1"),
    "cam_r2": ("CAM_R2", "CAM_BACK_RIGHT", "PCAM_R2"),
    "cam_b0": ("CAM_B0", "CAM_BACK", "PCAM_B0"),
}
#: Commands, in the order of NAVSIM's one-hot vector.
COMMANDS = ("left", "straight", "right", "unknown")
#: Last line of a PCD header.
PCD_DATA = b"DATA binary\n"
IMAGES_HELP = "images of the cameras: generated, or a map such as color (default auto: generated if there are any, else color)"


def driving_command(state: Message) -> Any:
    """Return the command of a state, one-hot ``int64 [4]``: left, straight, right, unknown."""
    return np.array([state["driving_command"] == name for name in COMMANDS], dtype=np.int64)


def ego_status(ego: Message, command: Any) -> dict[str, Any]:
    """Return the fields of an ``EgoStatus`` in the global frame.

    ``ego_pose`` ``float64 [3]`` (x, y, heading), ``ego_velocity`` and ``ego_acceleration`` ``float32 [2]`` in the ego frame. The rear
    axle does not slip, so its velocity is along x, and its acceleration across is speed times yaw rate.
    """
    return {
        "ego_pose": np.array([ego["x"], ego["y"], ego["heading"]], dtype=np.float64),
        "ego_velocity": np.array([ego["v"], 0.0], dtype=np.float32),
        "ego_acceleration": np.array([ego["a"], ego["v"] * ego["yaw_rate"]], dtype=np.float32),
        "driving_command": command,
        "in_global_frame": True,
    }


def relative(pose: Any, origin: Message) -> Any:
    """Return a pose (x, y, heading) in the frame of another, ``float32 [3]``."""
    x, y, heading = (float(value) for value in pose)
    east, north = x - origin["x"], y - origin["y"]
    cos, sin = math.cos(origin["heading"]), math.sin(origin["heading"])
    turn = math.remainder(heading - origin["heading"], math.tau)
    return np.array([cos * east + sin * north, cos * north - sin * east, turn], dtype=np.float32)


def camera(files: list[str], name: str, kind: str) -> dict[str, Any] | None:
    """Return the fields of NAVSIM's ``Camera`` from the files of a step; ``None`` if the step has no such camera.

    The LiDAR frame of NAVSIM is the ego frame: x forward, y left, z up. Intrinsics refer to the image's size.
    Raises ``PlannerError`` if the image of the camera is missing.
    """
    meta = next((Path(file) for file in files if Path(file).name == "meta.json"), None)
    if meta is None:
        return None
    known = {camera["name"]: camera for camera in json.loads(meta.read_bytes())["cameras"]}
    found = next((known[channel] for channel in CAMERAS[name] if channel in known), None)
    if found is None:
        return None
    path = image_path(meta.parent, found["name"], kind)
    image = read_image(path)
    scale = np.array([[image.shape[1] / found["width"]], [image.shape[0] / found["height"]], [1.0]])
    mount = np.array(found["ego_from_camera"], dtype=np.float64).reshape(4, 4)
    return {
        "image": image,
        "sensor2lidar_rotation": mount[:3, :3],
        "sensor2lidar_translation": mount[:3, 3],
        "intrinsics": np.array(found["intrinsics"], dtype=np.float64) * scale,
        "distortion": np.zeros(5),
        "camera_path": path,
    }


def lidar(files: list[str]) -> dict[str, Any] | None:
    """Return the fields of NAVSIM's ``Lidar`` from the files of a step; ``None`` if the step has no sweep.

    ``lidar_pc`` is ``float32 [6, N]``: x, y, z in meters in the ego frame, intensity, ring, device. Raises ``PlannerError`` for a file
    that is not as ``pskel simulate --lidar`` writes it.
    """
    paths = {Path(file).name: Path(file) for file in files}
    path = next((paths[name] for name in SWEEPS if name in paths), None)
    if path is None:
        return None
    try:
        points = SWEEPS[path.name](path.read_bytes())
    except (OSError, ValueError, IndexError) as error:
        raise PlannerError(f"expected the points of a sweep in {path}, found {error}") from None
    return {"lidar_pc": np.ascontiguousarray(points.T), "lidar_path": path}


def _bin(data: bytes) -> Any:
    points = np.frombuffer(data, "<f4").reshape(-1, 5)
    return np.column_stack([points, np.zeros(len(points), np.float32)])


def _npy(data: bytes) -> Any:
    return np.load(BytesIO(data), allow_pickle=False)[:, :6]


def _pcd(data: bytes) -> Any:
    row = np.dtype({"names": ["points", "ring", "device"], "formats": ["(4,)<f4", "<u2", "u1"], "offsets": [0, 16, 18], "itemsize": 28})
    rows = np.frombuffer(data[data.index(PCD_DATA) + len(PCD_DATA) :], row)
    return np.column_stack([rows["points"], rows["ring"], rows["device"]]).astype(np.float32)


#: Files of sweeps, each with how it is read: ``float32 [N, 6]``, x, y, z, intensity, ring, device.
SWEEPS = {"lidar.pcd.bin": _bin, "lidar.npy": _npy, "lidar.pcd": _pcd}


def pcd(points: Any) -> bytes:
    """Return points ``float32 [6, N]`` as a PCD file of nuPlan: x y z intensity lidar_info ring.

    Raises ``PlannerError`` for rings above 255.
    """
    if points.shape[1] and points[4].max() > 255:
        raise PlannerError(f"expected at most 256 rings, as nuPlan's files have, found ring {points[4].max():g}")
    row = np.dtype([("xyz", "<f4", 3), ("intensity", "u1"), ("device", "u1"), ("ring", "u1")])
    rows = np.zeros(points.shape[1], row)
    rows["xyz"], rows["intensity"], rows["ring"], rows["device"] = points[:3].T, points[3], points[4], points[5]
    fields = "FIELDS x y z intensity lidar_info ring\nSIZE 4 4 4 1 1 1\nTYPE F F F U U U\nCOUNT 1 1 1 1 1 1\n"
    size = f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\n"
    return f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n{fields}{size}".encode() + PCD_DATA + rows.tobytes()


def image_path(step: Path, channel: str, kind: str) -> Path:
    """Return the image of a camera in the folder of a step; ``kind`` as in ``IMAGES_HELP``."""
    generated = step / "generated" / f"{channel}.png"
    if kind == "generated" or kind == "auto" and generated.exists():
        return generated
    return step / channel / f"{'color' if kind == 'auto' else kind}.png"


def read_image(path: Path) -> Any:
    """Return an image, ``uint8 [H, W, 3]``."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except OSError as error:
        raise PlannerError(f"expected an image in {path}, found {error}") from None
