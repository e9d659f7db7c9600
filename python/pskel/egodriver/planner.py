"""Planner of docs/src/reference/planner.md whose plans come from a driver."""

from __future__ import annotations

import json
import os
import sys
import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from . import cameras, frames
from .cameras import Images
from .driver import Driver, DriverError, one_line
from .states import State, States

#: Images of this time before the first plan are sent again when a rollout is resumed, seconds.
HISTORY_S = 4.0
#: Time to close a session after the rollout; ``pskel simulate`` waits half a second for the end of a planner.
CLOSE_S = 0.4
#: Environment variable with the folder of a launcher: its file ``session`` names the open session, if any.
STATE = "PSKEL_DRIVER_STATE"


@dataclass(frozen=True)
class Options:
    """Options of a planner. ``cameras``: see ``cameras.logical_ids``; ``images``, ``encoding``: see ``cameras.Images``."""

    driver: str
    timeout_s: float
    images: str
    encoding: str
    cameras: str


def run(options: Options, lines: Iterable[str], out: TextIO) -> int:
    """Answer the messages of ``pskel simulate`` until they end. Returns the exit code; failures are one line on stderr."""
    driver = Driver(options.driver, options.timeout_s)
    planner = Planner(options, driver)
    code, close_s = 0, CLOSE_S
    try:
        for line in lines:
            driver.start_clock()
            print(json.dumps(planner.answer(_message(line))), file=out, flush=True)
    except DriverError as error:
        print(f"pskel.egodriver: {error}", file=sys.stderr, flush=True)
        code, close_s = 1, 2.0
    except BrokenPipeError:
        code = 1  # the rollout has ended
    if driver.close(close_s):
        _remember("")
    return code


class Planner:
    """One rollout: a session of a driver, which starts with the first observation."""

    def __init__(self, options: Options, driver: Driver) -> None:
        self._driver = driver
        self._images = Images(options.images, options.encoding)
        self._choice = options.cameras
        self._hello: dict[str, Any] = {}
        self._ids: dict[str, str] = {}
        self._states: States | None = None

    def answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Return the answer to a message. Raises ``DriverError``."""
        try:
            if message.get("type") == "observation":
                return self._plan(message)
            return self._greet(message)
        except (KeyError, TypeError, ValueError) as error:
            raise DriverError(f"expected a message of protocol pskel-planner, found {type(error).__name__} {error}") from None

    def _greet(self, hello: dict[str, Any]) -> dict[str, Any]:
        if hello.get("protocol") != "pskel-planner":
            raise DriverError(f"expected a hello of protocol pskel-planner, found {one_line(str(hello.get('protocol')))}")
        self._hello = hello
        version = self._driver.version()
        api = version.grpc_api_version
        text = f"{one_line(version.version_id, 80)}, API {api.major}.{api.minor}.{api.patch}"
        print(f"pskel.egodriver: driver {self._driver.target}: {text}", file=sys.stderr, flush=True)
        return {"protocol": "pskel-planner", "version": 1}

    def _plan(self, observation: dict[str, Any]) -> dict[str, Any]:
        number, now_us = int(observation["step"]), int(observation["t_us"])
        step = _folder(observation["files"])
        if self._states is None:
            self._states = States(step.parent.parent / "states.jsonl")
            states = self._states.until(number)
            self._start(step)
        else:
            states = self._states.until(number)
        self._observe(step, states, observation["path"])
        query_us = now_us + round(observation["plan_dt"] * 1e6)
        response = self._driver.drive(now_us, query_us)
        if response.terminate_session:
            raise DriverError(f"driver {self._driver.target}: expected a plan, found the end of its session at step {number}")
        start = (observation["ego"]["x"], observation["ego"]["y"])
        try:
            waypoints = frames.plan(response.trajectory, start, self._states.origin, now_us, query_us)
        except DriverError as error:
            raise DriverError(f"driver {self._driver.target}: {error} (step {number})") from None
        return {"step": number, "trajectory": waypoints}

    def _start(self, step: Path) -> None:
        names = [str(camera["name"]) for camera in cameras.rig(step)]
        self._ids = cameras.logical_ids(self._choice, names)
        session = str(uuid.uuid4())
        _remember(session)
        available = cameras.available(step, self._ids, self._images)
        self._driver.start(session, int(self._hello["seed"]), str(self._hello["log"]), available)

    def _observe(self, step: Path, states: list[State], path: list[list[float]]) -> None:
        """Send all steps committed since the last plan; with the first plan, all earlier ones."""
        assert self._states is not None
        now = states[-1]
        stride = round(self._hello["sim_hz"] / self._hello["plan_hz"])
        for state in states:
            if state.step % stride == 0 and now.t_us - state.t_us <= HISTORY_S * 1e6:
                folder = step.parent / f"{state.step:06}"
                for name, logical in self._ids.items():
                    self._driver.send_image(logical, state.t_us, self._images.read(folder, name))
        origin = self._states.origin
        self._driver.send_motion([state.pose(origin) for state in states], [state.derivatives() for state in states])
        self._driver.send_route(now.t_us, frames.route(path, now.global_from_ego))


def _message(line: str) -> dict[str, Any]:
    try:
        message = json.loads(line)
    except ValueError:
        message = None
    if not isinstance(message, dict):
        raise DriverError(f"expected a JSON object from pskel simulate, found {one_line(line, 80)!r}")
    return message


def _folder(files: list[str]) -> Path:
    """Folder of the step that has the files of an observation."""
    for file in files:
        path = Path(file)
        if path.name == "meta.json":
            return path.parent
    raise DriverError(f"expected meta.json among the files of a step, found {len(files)} files (--dry writes none)")


def _remember(session: str) -> None:
    """Name the open session for the launcher, which closes it if this process is killed."""
    folder = os.environ.get(STATE)
    if folder:
        Path(folder, "session").write_text(session)
