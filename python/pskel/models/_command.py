"""Command of a denoiser process: options, streams and errors that all networks share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from io import BufferedIOBase

import torch

from .._messages import standard_streams
from ._files import first_line

__all__ = ["DTYPES", "add_options", "device_of", "run", "run_on_standard_streams", "silence", "whole_number"]

DTYPES = {"bf16": torch.bfloat16, "f16": torch.float16, "f32": torch.float32}

Serve = Callable[[argparse.Namespace, BufferedIOBase, BufferedIOBase], None]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the device."""
    parser.add_argument("--device", default="cuda", help="cuda, cuda:N or cpu (default: cuda)")
    parser.add_argument(
        "--dtype", default="bf16", choices=DTYPES, help="type of weights and computation (default: bf16)"
    )
    parser.add_argument(
        "--cached-frames",
        type=whole_number,
        metavar="N",
        help="frames whose encoded conditions remain in the memory of the device (default: twice the window)",
    )


def run_on_standard_streams(program: str, options: argparse.Namespace, serve: Serve) -> int:
    """Serve on standard input and output; returns the exit status."""
    with standard_streams() as (source, out):
        return run(program, options, source, out, serve)


def run(program: str, options: argparse.Namespace, source: BufferedIOBase, out: BufferedIOBase, serve: Serve) -> int:
    """Load the models and serve; returns the exit status, after an error in one line on standard error."""
    try:
        serve(options, source, out)
    except (ValueError, OSError, ImportError) as error:
        return _failed(program, first_line(error))
    except (MemoryError, RuntimeError) as error:
        if not _is_out_of_memory(error):
            raise
        return _failed(
            program,
            f"out of memory on {options.device} with --dtype {options.dtype}: use bf16, a smaller size in the recipe, "
            f"a smaller --window or --cached-frames ({first_line(error)})",
        )
    except KeyboardInterrupt:
        return 130
    return 0


def device_of(name: str) -> torch.device:
    """Return the device of the option; raises ``ValueError`` for an unknown one."""
    kind, _, number = name.partition(":")
    if name != "cpu" and (kind != "cuda" or not (number or "0").isdecimal()):
        raise ValueError(f"expected --device cuda, cuda:N or cpu, found {name}")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if kind == "cuda" and int(number or 0) >= count:
        raise ValueError(
            f"expected a GPU for --device {name}, found {count} that PyTorch can use (--device cpu is slow)"
        )
    return torch.device(name)


def silence() -> None:
    """Switch progress bars and warnings of the libraries off."""
    import diffusers
    import transformers

    for logging in (diffusers.utils.logging, transformers.utils.logging):
        logging.set_verbosity_error()
        logging.disable_progress_bar()


def whole_number(text: str) -> int:
    """Convert the value of an option; raises ``argparse.ArgumentTypeError`` for other than digits."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number, found {text}")
    return int(text)


def _is_out_of_memory(error: BaseException) -> bool:
    is_cpu = isinstance(error, RuntimeError) and "can't allocate memory" in str(error)
    return is_cpu or isinstance(error, (MemoryError, torch.cuda.OutOfMemoryError))


def _failed(program: str, message: str) -> int:
    print(f"{program}: {message}", file=sys.stderr)
    return 1
