"""Rollouts as synthetic scenes of NAVSIM: ``python -m pskel.navsim_scenes ROLLOUT --out DIR`` (docs/src/reference/interop.md).

Writes ``DIR/synthetic_scene_pickles/TOKEN.pkl``, as ``navsim.common.dataclasses.Scene.load_from_disk`` reads it, and the images
``DIR/sensor_blobs/LOG/CAMERA/TOKEN.png``. Runs where nuplan-devkit is installed, since the future of a scene consists of its
objects; the compiled part of ``pskel`` is not needed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import pickle
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pskel._navsim import CAMERAS, FRAME_S, FRAMES, IMAGES_HELP, SWEEPS, camera, driving_command, ego_status, lidar, pcd, relative
from pskel._planner import Message, PlannerError
from pskel.nuplan_planner import kind_of, light_ids, lights, tracks

#: Names of the numbers of classes in ``states.jsonl``.
CLASSES = ("none", "motor_vehicle", "pedestrian", "cycle", "object")


class Rollout:
    """The files of a rollout."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.record = _json(folder / "rollout.json")
        path = folder / "states.jsonl"
        try:
            self.states = [_state(json.loads(line)) for line in path.read_text().splitlines()]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise PlannerError(f"expected the states of a rollout in {path}, found {type(error).__name__}: {error}") from None
        log = self.record.get("log")
        if not isinstance(log, str) or Path(log).name != log or log in ("", ".."):  # it becomes the name of a folder
            raise PlannerError(f"expected the name of a log in {folder / 'rollout.json'}, found {log!r}")
        if not self.states:
            raise PlannerError(f"expected the states of a rollout in {path}, found none")

    def stride(self) -> int:
        """Return the number of steps between frames."""
        steps = FRAME_S * float(self.record["sim_hz"])
        if abs(steps - round(steps)) > 1e-9 or steps < 1:
            raise PlannerError(f"expected steps that divide {FRAME_S} s, found {self.record['sim_hz']} steps a second")
        return round(steps)

    def files(self, step: int) -> list[str]:
        """Return a planner's files for a step: its metadata, which locates the images, and its LiDAR sweep."""
        folder = self.folder / "steps" / f"{step:06}"
        return [str(folder / "meta.json"), *(str(folder / name) for name in SWEEPS if (folder / name).exists())]


def write(rollout: Rollout, step: int, out: Path, options: argparse.Namespace) -> Path:
    """Write the scene whose last observed frame is a step; returns its file. Raises ``PlannerError`` for steps that cannot be one."""
    stride, last = rollout.stride(), len(rollout.states) - 1
    first = step - stride * (FRAMES - 1)
    end = step + stride * options.future
    if first < 0 or end > last:
        expected = f"a step from {stride * (FRAMES - 1)} to {last - stride * options.future}"
        raise PlannerError(f"expected {expected}, with {options.future} frames after it, found {step}")
    map_name = options.map or rollout.record.get("map_name")
    if not map_name:
        raise PlannerError("expected a log with a map of nuPlan, or --map NAME, found none")
    log = rollout.record["log"]
    frames = [
        _frame(rollout, rollout.states[at], out / "sensor_blobs", options.images) for at in range(first, step + 1, stride)
    ]
    later = rollout.states[step + stride : end + 1 : stride]
    token = frames[-1]["token"]
    scene = {
        "scene_metadata": {
            "log_name": log,
            "scene_token": token,
            "map_name": map_name,
            "initial_token": token,
            "num_history_frames": FRAMES,
            "num_future_frames": 0,
            "corresponding_original_scene": options.original_scene,
            "corresponding_original_initial_token": options.original_token,
        },
        "frames": frames,
        "extended_traffic_light_data": _future_lights(later),
        "extended_detections_tracks": _future_tracks(later),
    }
    path = out / "synthetic_scene_pickles" / f"{token}.pkl"
    _write(path, pickle.dumps(scene, protocol=pickle.HIGHEST_PROTOCOL))
    return path


def _frame(rollout: Rollout, state: Message, blobs: Path, images: str) -> Message:
    """Return a frame, and write its images."""
    token = _token(rollout, state)
    cameras: dict[str, Message] = {}
    for name in CAMERAS:
        found = camera(rollout.files(state["step"]), name, images)
        cameras[name] = {}
        if found is None:
            continue
        relative_path = Path(rollout.record["log"], name.upper(), f"{token}.png")
        _write(blobs / relative_path, found["camera_path"].read_bytes())
        cameras[name] = {
            "data_path": relative_path,
            "sensor2lidar_rotation": found["sensor2lidar_rotation"],
            "sensor2lidar_translation": found["sensor2lidar_translation"],
            "cam_intrinsic": found["intrinsics"],
            "distortion": found["distortion"],
        }
    return {
        "token": token,
        "timestamp": state["t_us"],
        "roadblock_ids": list(rollout.record.get("roadblocks", [])),
        "traffic_lights": [(number, light["color"] == "red") for number, light in zip(light_ids(state), state["lights"])],
        "annotations": _annotations(state),
        "ego_status": ego_status(state["ego"], driving_command(state)),
        "lidar_path": _sweep(rollout, state, blobs),
        "camera_dict": cameras,
    }


def _sweep(rollout: Rollout, state: Message, blobs: Path) -> Path | None:
    """Write the LiDAR sweep of a frame, if the rollout has one; returns its file below the folder of images."""
    found = lidar(rollout.files(state["step"]))
    if found is None:
        return None
    relative_path = Path(rollout.record["log"], "MergedPointCloud", f"{_token(rollout, state)}.pcd")
    _write(blobs / relative_path, pcd(found["lidar_pc"]))
    return relative_path


def _annotations(state: Message) -> Message:
    """Return the actors in the frame of the ego: boxes ``float32 [N, 7]`` (center, length, width, height, heading), velocities."""
    ego, actors = state["ego"], state["actors"]
    cos, sin = math.cos(ego["heading"]), math.sin(ego["heading"])
    boxes, velocities = np.zeros((len(actors), 7), np.float32), np.zeros((len(actors), 3), np.float32)
    for index, actor in enumerate(actors):
        x, y, heading = relative((actor["x"], actor["y"], actor["heading"]), ego)
        size = (actor["length"], actor["width"], actor["height"])
        boxes[index] = (x, y, actor["z"] - ego["z"], *size, heading)
        vx, vy = actor["vx"], actor["vy"]
        velocities[index, :2] = (cos * vx + sin * vy, cos * vy - sin * vx)
    names = [actor["track"] for actor in actors]
    return {
        "boxes": boxes,
        "names": [kind_of(actor) for actor in actors],
        "velocity_3d": velocities,
        "instance_tokens": names,
        "track_tokens": names,
    }


def _future_tracks(states: Sequence[Message]) -> list[Any]:
    numbers = {track: i for i, track in enumerate(sorted({a["track"] for state in states for a in state["actors"]}))}
    return [tracks(state, numbers) for state in states]


def _future_lights(states: Sequence[Message]) -> list[Any]:
    from nuplan.common.maps.maps_datatypes import TrafficLightStatuses

    return [TrafficLightStatuses(lights(state)) for state in states]


def _token(rollout: Rollout, state: Message) -> str:
    """Return the token of a frame, 16 hexadecimal digits: equal for equal states of a log."""
    text = json.dumps([rollout.record["log"], state], sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def _state(row: Message) -> Message:
    """Return a line of ``states.jsonl`` as a planner sees the state (docs/src/reference/planner.md)."""
    ego = row["ego"]
    (_, _, _, x), (_, _, _, y), (_, _, _, z), _ = ego["global_from_ego"]
    return {
        "step": row["step"],
        "t_us": row["t_us"],
        "driving_command": row["driving_command"],
        "lights": row["lights"],
        "ego": {
            "x": x,
            "y": y,
            "z": z,
            "heading": ego["heading_rad"],
            "v": ego["speed_mps"],
            "a": ego["acceleration_mps2"],
            "yaw_rate": ego["yaw_rate_radps"],
        },
        "actors": [_actor(actor) for actor in row["actors"]],
    }


def _actor(row: Message) -> Message:
    numbers = zip(("x", "y", "z", "length", "width", "height", "vx", "vy"), row["center_m"] + row["size_m"] + row["velocity_mps"])
    return {
        "track": row["track"],
        "category": row["category"],
        "class": CLASSES[row["class"]],
        "heading": row["heading_rad"],
        "yaw_rate": row["yaw_rate_radps"],
        **dict(numbers),
    }


def _json(path: Path) -> Message:
    try:
        value: Message = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise PlannerError(f"expected a rollout, found {error} ({path})") from None
    return value


def _write(path: Path, data: bytes) -> None:
    """Write a whole file or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    part.write_bytes(data)
    os.replace(part, path)


def main(arguments: list[str]) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m pskel.navsim_scenes", description="Write steps of a rollout as synthetic scenes of NAVSIM.", allow_abbrev=False
    )
    parser.add_argument("rollout", metavar="ROLLOUT", type=Path, help="folder of pskel simulate")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder of the scenes")
    parser.add_argument(
        "--steps", metavar="N,..", type=_numbers, help="last observed steps of the scenes (default: the first with 1.5 s before it)"
    )
    parser.add_argument("--future", metavar="N", type=int, default=8, help="frames of 0.5 s after it, without images (default 8)")
    parser.add_argument("--images", metavar="KIND", default="auto", help=IMAGES_HELP)
    parser.add_argument("--map", metavar="NAME", help="map of nuPlan (default: that of the log)")
    parser.add_argument("--original-scene", metavar="TOKEN", help="final token of the scene of the log that precedes these")
    parser.add_argument("--original-token", metavar="TOKEN", help="initial token of the scene of the log at the same time")
    given = parser.parse_args(arguments)
    try:
        rollout = Rollout(given.rollout)
        for step in given.steps or [rollout.stride() * (FRAMES - 1)]:
            print(write(rollout, step, given.out, given))
    except (PlannerError, OSError) as error:
        print(f"pskel.navsim_scenes: {error}", file=sys.stderr)
        return 1
    return 0


def _numbers(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected whole numbers, found {text!r}") from None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
