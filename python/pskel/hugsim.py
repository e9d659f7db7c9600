"""Clients of HUGSIM (UniAD, VAD, LTF) for ``pskel simulate``: ``--planner "python -m pskel.hugsim DIR"`` (docs/src/reference/interop.md).

Runs in any environment with NumPy and Pillow, Python 3.9 or later; the compiled part of ``pskel`` is not needed. ``DIR`` is the
``--output`` of the client, in which both open the named pipes ``obs_pipe`` and ``plan_pipe``. Plans are pickles, of which numbers
alone are read: nothing of a pickle is imported or called.
"""

from __future__ import annotations

import argparse
import errno
import io
import json
import math
import os
import pickle
import select
import stat
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pskel import _nuscenes, _planner
from pskel._navsim import IMAGES_HELP
from pskel._nuscenes import CAMERAS, LIDAR_FROM_EGO
from pskel._planner import Message, PlannerError

#: Rate of HUGSIM.
HZ = 4.0
#: Height and width of its images, pixels.
SIZE = (450, 800)
_MAX_BYTES = 1 << 16
_POLL_S = 0.05


class Bridge:
    """One rollout: writes images and states for a client, and converts its plans."""

    def __init__(self, pipes: Pipes, hello: Message, images: str) -> None:
        if abs(hello["plan_hz"] - HZ) > 1e-6:
            raise PlannerError(f"expected --plan-hz 4, the rate of HUGSIM, found {hello['plan_hz']:g}")
        self._pipes, self._images = pipes, images
        self._start: Message | None = None
        self._last_steering = 0.0

    def plan(self, see: Message) -> list[Message]:
        """Return the waypoints of the client for an observation."""
        if self._start is None:
            self._start, self._last_steering = see, see["ego"]["steering"]
        step = _nuscenes.step_of(see)
        images = {name: _nuscenes.image_of(step, name, self._images, SIZE, SIZE) for name in CAMERAS}
        state = state_of(see, self._start, self._last_steering)
        self._last_steering = see["ego"]["steering"]
        self._pipes.send(dumps(({"rgb": images}, {**state, "cam_params": cameras_of(step)})))
        return _nuscenes.waypoints_of(points_of(self._pipes.receive()), see["ego"])


def state_of(see: Message, start: Message, last_steering: float) -> Message:
    """Return the state of the ego in the frame of the first plan: right, down, forward; angles are clockwise."""
    ego, origin = see["ego"], start["ego"]
    cos, sin = math.cos(origin["heading"]), math.sin(origin["heading"])
    east, north = ego["x"] - origin["x"], ego["y"] - origin["y"]
    return {
        "ego_pos": [sin * east - cos * north, 0.0, cos * east + sin * north],
        "ego_rot": [0.0, math.remainder(origin["heading"] - ego["heading"], math.tau), 0.0],
        "ego_velo": ego["v"],
        "ego_steer": -ego["steering"],
        "accelerate": ego["a"],
        "steer_rate": (last_steering - ego["steering"]) * HZ,
        "timestamp": (see["t_us"] - start["t_us"]) / 1e6,
        "command": _nuscenes.COMMANDS[see["driving_command"]],
    }


def cameras_of(step: Path) -> Message:
    """Return the parameters of the cameras of a step at 450x800 pixels; ``l2c`` is the LiDAR's frame of nuScenes in the camera's."""
    known = {camera["name"]: camera for camera in json.loads((step / "meta.json").read_bytes())["cameras"]}
    if missing := [name for name in CAMERAS if name not in known]:
        raise PlannerError(f"expected the cameras {', '.join(CAMERAS)}, found none of {', '.join(missing)}")
    return {name: _camera(known[name]) for name in CAMERAS}


def _camera(found: Message) -> Message:
    height, width = SIZE
    (fx, _, cx), (_, fy, cy), _ = np.array(found["intrinsics"], np.float64).reshape(3, 3)
    across, down = width / found["width"], height / found["height"]
    camera_from_ego = np.linalg.inv(np.array(found["ego_from_camera"], np.float64).reshape(4, 4))
    intrinsic = {
        "H": height,
        "W": width,
        "fovx": 2 * math.atan(width / (2 * fx * across)),
        "fovy": 2 * math.atan(height / (2 * fy * down)),
        "cx": float(cx * across),
        "cy": float(cy * down),
    }
    return {"intrinsic": intrinsic, "l2c": camera_from_ego @ np.linalg.inv(LIDAR_FROM_EGO)}


class _Pickler(pickle.Pickler):
    """Writes arrays so that all versions of NumPy read them."""

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.ndarray, (value.shape, value.dtype.str, bytearray(value.tobytes()))
        return NotImplemented


def dumps(value: Any) -> bytes:
    """Return a pickle."""
    file = io.BytesIO()
    _Pickler(file, protocol=4).dump(value)
    return file.getvalue()


class _Dtype:
    """Takes the place of ``numpy.dtype`` in a pickle."""

    def __init__(self, kind: Any, *_: Any) -> None:
        self.kind, self.order = kind, "<"

    def __setstate__(self, state: Any) -> None:
        self.order = state[1]


class _Array:
    """Takes the place of ``numpy.ndarray`` in a pickle."""

    def __init__(self, *state: Any) -> None:
        self.state = state

    def __setstate__(self, state: Any) -> None:
        self.state = state


#: What pickles of arrays name, and what is called in its place. Modules of NumPy 2 have another name.
_STAND_INS: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Dtype,
    ("numpy.core.multiarray", "_reconstruct"): lambda *_: _Array(),
    ("numpy.core.numeric", "_frombuffer"): lambda content, kind, shape, order: _Array(1, shape, kind, order == "F", content),
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        known = _STAND_INS.get((module.replace("numpy._core", "numpy.core"), name))
        if known is None:
            raise PlannerError(f"expected a pickle of numbers, found {module}.{name}, which is not imported")
        return known


def points_of(content: bytes) -> npt.NDArray[np.float64]:
    """Return the points of a pickled plan, ``[N, 2]``; raises ``PlannerError`` for anything but finite numbers."""
    try:
        value = _Unpickler(io.BytesIO(content)).load()
        if isinstance(value, _Array):
            _, shape, dtype, is_fortran, data = value.state
            if dtype.kind not in ("f4", "f8") or dtype.order not in ("<", ">", "="):
                raise PlannerError(f"expected a plan of f4 or f8, found {dtype.kind}")
            value = np.frombuffer(data, dtype.order + dtype.kind).reshape(shape, order="F" if is_fortran else "C")
    except PlannerError:
        raise
    except Exception as error:  # of any kind: pickles are programs
        raise PlannerError(f"expected a pickled plan, found {type(error).__name__}: {error}") from None
    if value is None:
        raise PlannerError("expected a plan, found none: the client has failed")
    return _nuscenes.points_of(value, "a plan")


class Pipes:
    """The named pipes in a folder. Each message is what one side writes between opening and closing a pipe."""

    def __init__(self, folder: Path, timeout_s: float) -> None:
        self._timeout_s, self._observations, self._plans = timeout_s, folder / "obs_pipe", folder / "plan_pipe"
        folder.mkdir(parents=True, exist_ok=True)
        for path in (self._observations, self._plans):
            if not path.exists():
                os.mkfifo(path, 0o600)
            if not stat.S_ISFIFO(path.stat().st_mode):
                raise ValueError(f"expected a named pipe, found another file: {path}")

    def send(self, content: bytes) -> None:
        """Write a message once the client reads."""
        end_s = time.monotonic() + self._timeout_s
        pipe = self._opened(end_s)
        try:
            left = memoryview(content)
            while left:
                self._wait(pipe, select.POLLOUT, end_s)
                left = left[os.write(pipe, left) :]
        except BrokenPipeError:
            raise PlannerError("expected a client that reads observations, found that it has ended") from None
        finally:
            os.close(pipe)

    def receive(self) -> bytes:
        """Read a message of the client."""
        end_s, content = time.monotonic() + self._timeout_s, b""
        pipe = os.open(self._plans, os.O_RDONLY | os.O_NONBLOCK)
        try:
            while True:
                self._wait(pipe, select.POLLIN, end_s)
                part = os.read(pipe, _MAX_BYTES)
                content += part
                if len(content) > _MAX_BYTES:
                    raise PlannerError(f"expected a plan of at most {_MAX_BYTES} bytes, found more")
                if not part and content:
                    return content
                if not part:
                    raise PlannerError("expected a plan of the client, found that it has ended")
        finally:
            os.close(pipe)

    def end(self) -> None:
        """Tell a client that the rollout has ended, if one reads."""
        self._timeout_s = min(self._timeout_s, 1.0)
        try:
            self.send(dumps("Done"))
        except PlannerError:
            pass

    def _opened(self, end_s: float) -> int:
        while True:
            try:
                return os.open(self._observations, os.O_WRONLY | os.O_NONBLOCK)
            except OSError as error:
                if error.errno != errno.ENXIO:  # nobody reads
                    raise
            if time.monotonic() > end_s:
                raise PlannerError(f"expected a client that reads {self._observations} within {self._timeout_s:g} s, found none")
            time.sleep(_POLL_S)

    def _wait(self, pipe: int, event: int, end_s: float) -> None:
        poll = select.poll()
        poll.register(pipe, event)
        if not poll.poll(max(end_s - time.monotonic(), 0.0) * 1e3):
            raise PlannerError(f"expected an answer of the client within {self._timeout_s:g} s, found none")


def main(arguments: list[str]) -> int:
    """Run the command; returns its exit code."""
    about = "Plan for pskel simulate with a client of HUGSIM."
    parser = argparse.ArgumentParser(prog="python -m pskel.hugsim", description=about, allow_abbrev=False)
    parser.add_argument("folder", metavar="DIR", type=Path, help="the --output of the client, which has the pipes")
    parser.add_argument("--timeout", metavar="S", type=_planner.seconds, default=60.0, help="seconds for each message (default 60)")
    parser.add_argument("--images", metavar="KIND", default="auto", help=IMAGES_HELP)
    given = parser.parse_args(arguments)
    try:
        pipes = Pipes(given.folder, given.timeout)
    except (ValueError, OSError) as error:
        print(f"pskel.hugsim: {error}", file=sys.stderr)
        return 1
    lines, out = _planner.messages()
    try:
        return _planner.serve(lambda hello: Bridge(pipes, hello, given.images).plan, lines, out)
    finally:
        pipes.end()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
