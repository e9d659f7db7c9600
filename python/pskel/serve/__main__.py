"""The command ``python -m pskel.serve``."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Sequence
from functools import partial

os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # failures are reported by this command

import pskel
from pskel.alpasim import video_model_pb2

from .scenes import Scenes, sources
from .service import GRACE_S, Service, serve
from .world import Settings, WorldModel

ENCODINGS = {"jpeg": video_model_pb2.JPEG, "png": video_model_pb2.PNG}


def main(arguments: Sequence[str]) -> int:
    """Run the command until a signal; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m pskel.serve",
        description="Serve logs with their skeletons as a renderer of AlpaSim (nre.grpc.protos.sensorsim.SensorsimService), and with "
        "--generator as a world model (omnidreams.video_model.WorldModelService).",
        allow_abbrev=False,
    )
    parser.add_argument("skeletons", metavar="SKELETON", nargs="+", help="folder of pskel build")
    parser.add_argument("--log", metavar="LOG", action="append", required=True, help="a log of the skeletons; repeat it for more scenes")
    parser.add_argument("--port", metavar="N", type=int, required=True, help="port; 0 chooses a free one")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default %(default)s: this machine only)")
    parser.add_argument(
        "--images", choices=("filled", "color"), default="filled", help="color map with or without its holes filled (default %(default)s)"
    )
    parser.add_argument("--splat", metavar="Z:R,..", help="splat radii at the size of the images, as of pskel render")
    parser.add_argument("--open-scenes", metavar="N", type=int, default=4, help="scenes that remain open (default %(default)s)")
    parser.add_argument("--threads", metavar="N", type=int, default=4, help="requests in progress (default %(default)s)")
    world = parser.add_argument_group("world model")
    world.add_argument("--generator", metavar="G", help="generator of its images: network, fill, process:P, images:P, as of pskel simulate")
    world.add_argument("--recipe", metavar="F.json", help="how its conditions are rendered, as of pskel simulate")
    world.add_argument("--window", metavar="N", type=int, help="its window in frames, as of pskel simulate")
    world.add_argument("--generator-timeout", metavar="S", type=float, default=60.0, help="time for each answer of P (default %(default)g)")
    world.add_argument("--fps", metavar="N", type=float, default=30.0, help="frames per second of all sessions (default %(default)g)")
    world.add_argument("--encoding", choices=ENCODINGS, default="jpeg", help="format of the images (default %(default)s)")
    world.add_argument("--sessions", metavar="N", type=int, default=4, help="sessions that are open at a time (default %(default)s)")
    world.add_argument("--idle", metavar="S", type=float, default=600.0, help="a start ends sessions idle for so long (default %(default)g)")
    given = parser.parse_args(arguments)
    if given.open_scenes < 1 or given.threads < 1 or not 0 <= given.port < 1 << 16:
        parser.error("expected --open-scenes and --threads of at least 1 and a --port below 65536")
    if not (0.0 < given.fps <= 1000.0 and given.sessions >= 1 and given.idle > 0.0 and 0.0 < given.generator_timeout < 1e6):
        parser.error("expected --fps, --sessions, --idle and --generator-timeout above 0, and --fps of at most 1000")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        scenes = Scenes(sources(given.skeletons, given.log), given.open_scenes, given.splat)
        model = WorldModel(scenes, _settings(given)) if given.generator is not None else None
        server, port = serve(Service(scenes, given.images == "filled"), f"{given.host}:{given.port}", given.threads, model)
    except (OSError, ValueError, pskel.Error) as error:
        print(f"pskel.serve: {error}", file=sys.stderr)
        return 1
    print(f"pskel.serve: {given.host}:{port}: {', '.join(scenes.names)}", flush=True)
    stop.wait()
    server.stop(GRACE_S).wait()
    if model is not None:
        model.close()
    return 0


def _settings(given: argparse.Namespace) -> Settings:
    opened = partial(
        pskel.Generator, given.generator, fps=given.fps, recipe=given.recipe, window=given.window, timeout=given.generator_timeout
    )
    return Settings(opened, given.fps, ENCODINGS[given.encoding], given.sessions, given.idle)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
