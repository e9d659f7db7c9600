"""Starts ``pskel simulate`` with this package as its planner."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .driver import Driver, DriverError
from .planner import STATE, Options

DRIVER, TIMEOUT, PYTHON = "PSKEL_DRIVER", "PSKEL_DRIVER_TIMEOUT", "PSKEL_PYTHON"
#: Options of ``pskel simulate`` that this command sets.
SET = ("--ego", "--planner", "--planner-timeout", "--dry")
#: Time by which the planner's own time-out comes first, seconds; includes the start of its process.
MARGIN_S = 30.0
#: Time to close the session of a planner that was killed, seconds.
CLOSE_S = 5.0


def planner(options: Options) -> str:
    """Return the command of the planner, for ``sh``. It is part of a rollout, and equal when that is resumed, so it has neither the
    address of the driver nor the path of Python, which may change."""
    values = ("--images", options.images, "--encoding", options.encoding, "--cameras", options.cameras)
    return f'"${PYTHON}" -m pskel.egodriver {shlex.join(values)}'


def run(options: Options, simulate: Sequence[str]) -> int:
    """Run a rollout with the arguments ``simulate`` of ``pskel simulate``; returns its exit code.

    The session of the driver is closed also if the planner was killed. Raises ``DriverError`` for options that are set here.
    """
    for argument in simulate:
        if argument.partition("=")[0] in SET:
            raise DriverError(f"expected options of pskel simulate other than {', '.join(SET)}, found {argument}")
    command = [sys.executable, "-m", "pskel", "simulate", *simulate, "--ego", "external", "--planner", planner(options)]
    command.append(f"--planner-timeout={options.timeout_s + MARGIN_S}")
    with tempfile.TemporaryDirectory(prefix="pskel-") as folder:
        own = {PYTHON: sys.executable, DRIVER: options.driver, TIMEOUT: str(options.timeout_s), STATE: folder}
        code = _wait(command, {**os.environ, **own})
        file = Path(folder, "session")
        session = file.read_text() if file.exists() else ""
        if session:
            driver = Driver(options.driver, CLOSE_S)
            driver.session = session
            driver.close(CLOSE_S)
    return code


def _wait(command: Sequence[str], environment: dict[str, str]) -> int:
    """Run a command; returns its exit code as a shell does. Signals of this process are passed on.

    A terminal signals both processes; ``pskel simulate`` ignores a second signal that follows at once.
    """
    child: subprocess.Popen[bytes] | None = None
    pending: list[int] = []

    def forward(number: int, _: Any) -> None:
        if child is None:
            pending.append(number)
        else:
            child.send_signal(number)

    numbers = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, forward) for number in numbers}
    try:
        child = subprocess.Popen(command, env=environment)
        for number in pending:
            child.send_signal(number)
        code = child.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return code if code >= 0 else 128 - code
