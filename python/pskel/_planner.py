"""Protocol of docs/src/reference/planner.md for planners written in Python. No dependencies, so that it works in any environment."""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TextIO

Message = dict[str, Any]
#: Answers an observation with waypoints.
Plan = Callable[[Message], list[Message]]

PROTOCOL = "pskel-planner"


class PlannerError(Exception):
    """Missing or unsupported input of a planner; one line."""


def serve(start: Callable[[Message], Plan], lines: Iterable[str], out: TextIO) -> int:
    """Answer the messages of ``pskel simulate`` until they end; returns the exit code.

    ``start`` is called with the hello. After an exception the answer is its message, its traceback is on stderr, and the exit code
    is 1.
    """
    plan: Plan | None = None
    for line in lines:
        try:
            message = json.loads(line)
            if plan is None:
                if message.get("protocol") != PROTOCOL:
                    raise PlannerError(f"expected a hello of protocol {PROTOCOL}, found {message.get('protocol')}")
                plan = start(message)
                answer = {"protocol": PROTOCOL, "version": 1}
            else:
                answer = {"step": message["step"], "trajectory": plan(message)}
            text = json.dumps(answer, allow_nan=False)
        except Exception as error:  # of any kind: the code of the user
            if not isinstance(error, PlannerError):
                traceback.print_exc()
            known = str(error) if isinstance(error, PlannerError) else f"{type(error).__name__}: {error}"
            _send(out, json.dumps({"error": " ".join(known.split())[:500]}))
            return 1
        if not _send(out, text):
            return 1
    return 0


def _send(out: TextIO, text: str) -> bool:
    """Returns ``False`` if the rollout has ended."""
    try:
        print(text, file=out, flush=True)
    except BrokenPipeError:
        return False
    return True


def messages() -> tuple[Iterable[str], TextIO]:
    """Return the lines of ``pskel simulate`` and the stream of answers; all other output of this process goes to stderr."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), 1)
    sys.stdout = sys.stderr
    return sys.stdin, answers


def waypoints(start: tuple[float, float], points: Sequence[tuple[float, float, float, float]]) -> list[Message]:
    """Return the waypoints of a plan without speeds.

    ``points`` have seconds after the observation (rising from over 0), x, y (meters) and heading (radians);
    ``start`` is the ego at the observation. Speeds are central differences of positions along the heading.
    The last point uses a backward difference.
    """
    known = [(0.0, *start), *((t, x, y) for t, x, y, _ in points)]
    plan = []
    for index, (t, x, y, heading) in enumerate(points):
        (t0, x0, y0), (t1, x1, y1) = known[index], known[min(index + 2, len(points))]
        along = (x1 - x0) * math.cos(heading) + (y1 - y0) * math.sin(heading)
        plan.append({"t": t, "x": x, "y": y, "heading": heading, "v": along / (t1 - t0)})
    return plan


def parser(command: str, what: str, description: str) -> argparse.ArgumentParser:
    """Return the parser of a command whose first argument names a class of the user."""
    parser = argparse.ArgumentParser(prog=f"python -m pskel.{command}", description=description, allow_abbrev=False)
    parser.add_argument("name", metavar="MODULE:CLASS", help=f"{what}, or a function that returns one")
    parser.add_argument(
        "--args", metavar="JSON", default={}, type=_object, help="its keyword arguments, a JSON object (default {})"
    )
    return parser


def _object(text: str) -> Message:
    try:
        value = json.loads(text)
    except ValueError:
        value = None
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError(f"expected a JSON object, found {text!r}")
    return value


def seconds(text: str) -> float:
    """Convert the value of an option; raises ``argparse.ArgumentTypeError`` unless it is a number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected seconds above 0, found {text}")
    return value


def create(name: str, arguments: Message) -> Any:
    """Return a new object of the class ``MODULE:CLASS``. Raises ``PlannerError`` if there is no such class."""
    module, _, attribute = name.partition(":")
    sys.path.insert(0, os.getcwd())
    try:
        made = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise PlannerError(f"expected MODULE:CLASS, found {name}: {error}") from None
    return made(**arguments)
