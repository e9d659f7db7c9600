"""The command ``python -m pskel.drivearena``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pskel import _planner, images
from pskel._navsim import IMAGES_HELP

from .agent import Agent
from .dreamer import Dreamer
from .server import Server
from .road_map import RoadMap


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    about = "World dreamer and agents of DriveArena."
    parser = argparse.ArgumentParser(prog="python -m pskel.drivearena", description=about, allow_abbrev=False)
    commands = parser.add_subparsers(dest="command", required=True)
    dreamer = commands.add_parser("dreamer", help="the world dreamer as a generator: --generator images:..", allow_abbrev=False)
    agent = commands.add_parser("agent", help="a driving agent as a planner: --ego external --planner ..", allow_abbrev=False)
    for command in (dreamer, agent):
        command.add_argument("--url", required=True, help="address of the server, http://HOST:PORT")
        command.add_argument("--timeout", type=_planner.seconds, default=60.0, metavar="S", help="seconds for each answer (default 60)")
    dreamer.add_argument("--listen", metavar="ADDRESS", help="unix:PATH or tcp:HOST:PORT in place of standard input and output")
    map_help = "map expansion of nuScenes: lines and drivable area (default: none are sent)"
    dreamer.add_argument("--map", type=Path, metavar="F.json", help=map_help)
    dreamer.add_argument("--location", help="name of the place in the prompt (default: the map's)")
    dreamer.add_argument("--description", metavar="TEXT", help="text of the prompt (default: the captions of the log)")
    agent.add_argument("--images", metavar="KIND", default="auto", help=IMAGES_HELP)
    return parser


def main(arguments: list[str]) -> int:
    """Run the command; returns its exit code."""
    given = parser().parse_args(arguments)
    try:
        server = Server(given.url, given.timeout)
        if given.command == "dreamer":
            return _dream(given, server)
    except KeyboardInterrupt:
        return 130
    except (ValueError, OSError, ImportError) as error:
        print(f"pskel.drivearena: {error}", file=sys.stderr)
        return 1
    lines, out = _planner.messages()
    return _planner.serve(lambda hello: Agent(server, hello, given.images, given.timeout).plan, lines, out)


def _dream(given: argparse.Namespace, server: Server) -> int:
    road_map = RoadMap.load(given.map) if given.map else None
    if road_map is None:
        print("pskel.drivearena: without --map the world dreamer gets no lines and no drivable area", file=sys.stderr)
    location = given.location or (given.map.stem if given.map else "")
    images.serve(lambda hello: Dreamer(server, hello, road_map, location, given.description), given.listen)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
