"""Denoiser process: `python -m pskel.models.pas --weights pas.pth --base SD35_DIR` (docs/src/reference/pas.md)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from io import BufferedIOBase
from typing import Any

from .. import _command
from .._rig import CAMERA_NUMBERS
from .checkpoint import read_header
from .config import Config

_PROGRAM = "pskel.models.pas"


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the denoiser protocol on standard input and output; returns the exit status."""
    return _command.run_on_standard_streams(_PROGRAM, parser().parse_args(arguments), _serve)


def run(options: argparse.Namespace, source: BufferedIOBase, out: BufferedIOBase) -> int:
    """Load the models and serve; returns the exit status, after an error in one line on standard error."""
    return _command.run(_PROGRAM, options, source, out, _serve)


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
    parser.add_argument(
        "--config",
        metavar="F.json",
        help="sizes of the network (default: those in the header of the weights, else of the published checkpoints)",
    )
    parser.add_argument(
        "--camera-numbers",
        choices=CAMERA_NUMBERS,
        help="intrinsics that the network was trained with (default: those in the header of the weights, else of the "
        "published checkpoint for these cameras; nuPlan: fx,0,cx,fy)",
    )
    _command.add_options(parser)
    return parser


def _serve(options: argparse.Namespace, source: BufferedIOBase, out: BufferedIOBase) -> None:
    device = _command.device_of(options.device)
    header = read_header(options.weights)
    config = _config(options.config, header, options.weights)
    numbers: Any = options.camera_numbers or header.get("camera_numbers")
    # These import transformers.
    from .denoiser import Models
    from .server import serve

    _command.silence()
    models = Models.load(options.weights, options.base, config, dtype=_command.DTYPES[options.dtype], device=device)
    serve(source, out, models, cached_frames=options.cached_frames, camera_numbers=numbers)


def _config(path: str | None, header: dict[str, Any], weights: str) -> Config:
    if path is not None:
        return Config.read(path)
    return Config.parse(header["config"], weights) if "config" in header else Config()


if __name__ == "__main__":
    sys.exit(main())
