"""The command line: `python -m pskel`."""

import os
import signal
import sys

from ._pskel import run_command


def main() -> None:
    """Run the command with the arguments of this process, and exit with its code."""
    os.environ.setdefault("PSKEL_PYTHON", sys.executable)  # `pskel protocol` starts `python -m pskel.metrics`
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the command installs its own handler
    sys.exit(run_command(["pskel", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
