"""Denoiser process: `python -m pskel.models.pas --weights pas.pth --base SD35_DIR` (docs/src/reference/pas.md)."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from io import BufferedIOBase

import torch

from .base import first_line
from .config import Config

_DTYPES = {"bf16": torch.bfloat16, "f16": torch.float16, "f32": torch.float32}
_PROGRAM = "pskel.models.pas"


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the denoiser protocol on standard input and output; returns the exit status."""
    options = parser().parse_args(arguments)
    # From here on, all other output, from Python or not, goes to standard error.
    with open(0, "rb", closefd=False) as source, open(os.dup(1), "wb") as out:
        os.dup2(2, 1)
        return run(options, source, out)


def run(options: argparse.Namespace, source: BufferedIOBase, out: BufferedIOBase) -> int:
    """Load the models and serve; returns the exit status, after an error in one line on standard error."""
    try:
        _serve(options, source, out)
    except (ValueError, OSError, ImportError) as error:
        return _failed(first_line(error))
    except (MemoryError, RuntimeError) as error:
        if not _is_out_of_memory(error):
            raise
        return _failed(
            f"out of memory on {options.device} with --dtype {options.dtype}: use bf16, a smaller size in the recipe, "
            f"a smaller --window or --cached-frames ({first_line(error)})"
        )
    except KeyboardInterrupt:
        return 130
    return 0


def parser() -> argparse.ArgumentParser:
    """Return the parser of the options."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {_PROGRAM}",
        description="Serve the network of Point as Skeleton as a denoiser of pskel, on standard input and output.",
    )
    parser.add_argument("--weights", required=True, metavar="FILE", help="checkpoint: torch.save(state_dict) or .safetensors")
    parser.add_argument(
        "--base",
        required=True,
        metavar="DIR",
        help="Stable Diffusion 3.5 Medium, with vae, text_encoder, text_encoder_2, text_encoder_3 and their tokenizers",
    )
    parser.add_argument("--config", metavar="F.json", help="sizes of the network (default: the published checkpoints)")
    parser.add_argument("--device", default="cuda", help="cuda, cuda:N or cpu (default: cuda)")
    parser.add_argument("--dtype", default="bf16", choices=_DTYPES, help="type of weights and computation (default: bf16)")
    parser.add_argument(
        "--cached-frames",
        type=_count,
        metavar="N",
        help="frames whose encoded conditions remain in the memory of the device (default: twice the window)",
    )
    return parser


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number, found {text}")
    return int(text)


def _serve(options: argparse.Namespace, source: BufferedIOBase, out: BufferedIOBase) -> None:
    device = _device(options.device)
    config = Config() if options.config is None else Config.read(options.config)
    # These import transformers.
    from .denoiser import Models
    from .server import serve

    _silence()
    models = Models.load(options.weights, options.base, config, dtype=_DTYPES[options.dtype], device=device)
    serve(source, out, models, cached_frames=options.cached_frames)


def _device(name: str) -> torch.device:
    kind, _, number = name.partition(":")
    if name != "cpu" and (kind != "cuda" or not (number or "0").isdecimal()):
        raise ValueError(f"expected --device cuda, cuda:N or cpu, found {name}")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if kind == "cuda" and int(number or 0) >= count:
        raise ValueError(f"expected a GPU for --device {name}, found {count} that PyTorch can use (--device cpu is slow)")
    return torch.device(name)


def _silence() -> None:
    """Switch progress bars and warnings of the libraries off."""
    import diffusers
    import transformers

    for logging in (diffusers.utils.logging, transformers.utils.logging):
        logging.set_verbosity_error()
        logging.disable_progress_bar()


def _is_out_of_memory(error: BaseException) -> bool:
    is_cpu = isinstance(error, RuntimeError) and "can't allocate memory" in str(error)
    return is_cpu or isinstance(error, (MemoryError, torch.cuda.OutOfMemoryError))


def _failed(message: str) -> int:
    print(f"{_PROGRAM}: {message}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
