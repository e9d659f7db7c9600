"""Train a network: ``python -m pskel.train CONFIG --data .. --out DIR``."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn

from .config import Config, DataOptions, TrainOptions
from .errors import ConfigError, TrainError
from .variants import VARIANTS

PROGRAM = "pskel.train"


def _keys(table: str, kind: type[TrainOptions] | type[DataOptions]) -> str:
    """Return a table's keys with their defaults; ``null`` has none."""
    defaults = ", ".join(f"{key} = {json.dumps(value)}" for key, value in asdict(kind()).items())
    return textwrap.fill(f"[{table}] {defaults}", 100, initial_indent="  ", subsequent_indent="    ")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}",
        description="Trains an image generator. Several GPUs: torchrun --nproc-per-node N -m pskel.train ..",
        epilog=f"Keys of CONFIG, and their defaults:\n{_keys('train', TrainOptions)}\n{_keys('data', DataOptions)}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "config", metavar="CONFIG", help="TOML or JSON file: network, [train], [data], and the network's own table"
    )
    parser.add_argument(
        "--data",
        nargs="+",
        action="extend",
        default=[],
        required=True,
        metavar="SPEC",
        help="a log (town:.., nuscenes:..), an export (--layout webdataset --images), or recorded clips (.safetensors)",
    )
    parser.add_argument(
        "--out", required=True, type=Path, metavar="DIR", help="folder of checkpoints, losses, pictures and weights"
    )
    parser.add_argument("--resume", action="store_true", help="continue from the last checkpoint in DIR")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="settings",
        help="change the configuration: train.batch=2",
    )
    parser.add_argument(
        "--variant",
        metavar="NAME",
        help=f"train as a row of the paper's ablation; --set comes after it: {', '.join(VARIANTS)}",
    )
    parser.add_argument("--steps", type=int, metavar="N", help="the same as --set train.steps=N")
    return parser


def _stop(number: int, _frame: Any) -> None:
    """End at once: what is written is complete at any time. An exception could come while a library holds a lock."""
    text = (
        "interrupted" if number == signal.SIGINT else f"ended by signal {number}, perhaps since another process ended"
    )
    os.write(2, f"\n{PROGRAM}: {text}; --resume continues from the last checkpoint\n".encode())
    os._exit(130 if number == signal.SIGINT else 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status. An error is one line on standard error."""
    options = _parser().parse_args(arguments)
    settings = [*options.settings, *([] if options.steps is None else [f"train.steps={options.steps}"])]
    try:
        config = Config.read(options.config, settings, options.variant)
        try:
            from .loop import train
        except ImportError as error:
            raise ConfigError(f"training needs PyTorch and accelerate: pip install 'pskel[train]' ({error})") from error
        given = [each for each in (sys.argv[1:] if arguments is None else arguments) if each != "--resume"]
        command = shlex.join(["python", "-m", PROGRAM, *given])
        train(config, options.data, options.out, resume=options.resume, command=command)
    except TrainError as error:
        if not error.of_all or os.environ.get("RANK", "0") == "0":
            print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 1
    return 0


def end(status: int) -> NoReturn:
    """End this process after its last training."""
    sys.stdout.flush()
    sys.stderr.flush()
    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        if not status:
            from .parallel import end_processes

            end_processes()
        # Without the interpreter's teardown: libraries of communication wait for lost processes in it, and PyTorch's
        # threads abort some processes that have succeeded.
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, _stop)
    signal.signal(signal.SIGINT, _stop)
    end(main())
