"""The command ``python -m pskel.egodriver``: a rollout with a driver, or, without arguments of ``pskel simulate``, the planner."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from . import launch, planner
from .driver import DriverError


def _timeout(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 3600.0:
        raise argparse.ArgumentTypeError(f"expected a time over 0 s, at most an hour, found {text!r}")
    return value


def parser() -> argparse.ArgumentParser:
    """Return the parser for options that ``pskel simulate`` does not have."""
    parser = argparse.ArgumentParser(
        prog="python -m pskel.egodriver",
        usage="%(prog)s LOG --skeleton SK --driver HOST:PORT --out DIR --steps N [OPTIONS] [OPTIONS OF pskel simulate]",
        description="Run a log in closed loop with a driving policy that is served as AlpaSim's egodriver.EgodriverService.",
        epilog="Without LOG it is the planner of such a rollout, for pskel simulate --ego external --planner.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--driver", metavar="ADDRESS", default=os.environ.get(launch.DRIVER), help="HOST:PORT or unix:PATH of the driver"
    )
    parser.add_argument(
        "--driver-timeout",
        metavar="S",
        type=_timeout,
        default=os.environ.get(launch.TIMEOUT, "60"),
        help="time for all calls of a planning step, and for the driver to start listening, seconds (default 60)",
    )
    parser.add_argument(
        "--images",
        default="auto",
        help="images of the driver's cameras: generated, truth, or a map such as color (default: generated with --generator, else color)",
    )
    parser.add_argument("--encoding", choices=("png", "jpeg"), default="png", help="encoding of the images (default png)")
    parser.add_argument(
        "--cameras",
        metavar="CAM[=ID],..",
        default="all",
        help="cameras and their IDs at the driver; all: all with their own names (default); alpasim: names of AlpaSim's vehicles",
    )
    return parser


def main(arguments: Sequence[str]) -> int:
    """Run the command; returns its exit code."""
    given, rest = parser().parse_known_args(arguments)
    try:
        if not given.driver:
            raise DriverError("expected --driver HOST:PORT, found none")
        options = planner.Options(given.driver, given.driver_timeout, given.images, given.encoding, given.cameras)
        return launch.run(options, rest) if rest else planner.run(options, sys.stdin, sys.stdout)
    except DriverError as error:
        print(f"pskel.egodriver: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
