"""The command ``python -m pskel.serve``."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Sequence

os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # failures are reported by this command

import pskel

from .scenes import Scenes, sources
from .service import GRACE_S, Service, serve


def main(arguments: Sequence[str]) -> int:
    """Run the command until a signal; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m pskel.serve",
        description="Serve logs with their skeletons as a renderer of AlpaSim (nre.grpc.protos.sensorsim.SensorsimService).",
        allow_abbrev=False,
    )
    parser.add_argument("skeletons", metavar="SKELETON", nargs="+", help="folder of pskel build")
    parser.add_argument("--log", metavar="LOG", action="append", required=True, help="a log of the skeletons; repeat it for more scenes")
    parser.add_argument("--port", metavar="N", type=int, required=True, help="port; 0 chooses a free one")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default %(default)s: this machine only)")
    parser.add_argument("--images", choices=("filled", "color"), default="filled", help="color map with or without its holes filled (default %(default)s)")
    parser.add_argument("--splat", metavar="Z:R,..", help="splat radii at the size of the images, as of pskel render")
    parser.add_argument("--open-scenes", metavar="N", type=int, default=4, help="scenes that remain open (default %(default)s)")
    parser.add_argument("--threads", metavar="N", type=int, default=4, help="requests in progress (default %(default)s)")
    given = parser.parse_args(arguments)
    if given.open_scenes < 1 or given.threads < 1 or not 0 <= given.port < 1 << 16:
        parser.error("expected --open-scenes and --threads of at least 1 and a --port below 65536")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        scenes = Scenes(sources(given.skeletons, given.log), given.open_scenes, given.splat)
        server, port = serve(Service(scenes, given.images == "filled"), f"{given.host}:{given.port}", given.threads)
    except (OSError, ValueError, pskel.Error) as error:
        print(f"pskel.serve: {error}", file=sys.stderr)
        return 1
    print(f"pskel.serve: {given.host}:{port}: {', '.join(scenes.names)}", flush=True)
    stop.wait()
    server.stop(GRACE_S).wait()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
