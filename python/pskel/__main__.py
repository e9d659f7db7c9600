"""The command line: `python -m pskel`."""

import signal
import sys

from ._pskel import run_command


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the command has its own handlers
    run_command(["pskel", *sys.argv[1:]])


if __name__ == "__main__":
    main()
