"""Denoiser process: `python -m pskel.models.pas_image --weights W --base SD15_DIR` (docs/src/reference/pas.md)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from io import BufferedIOBase
from typing import TYPE_CHECKING

from .. import _command, _protocol
from .._protocol import Hello, Sampling
from .checkpoint import Training
from .config import HISTORY_LEVEL

if TYPE_CHECKING:
    from .denoiser import Denoiser

_PROGRAM = "pskel.models.pas_image"


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
        description="Serve the image variant of Point as Skeleton to pskel, on standard input and output.",
    )
    parser.add_argument(
        "--weights", required=True, metavar="FILE", help="weights.safetensors of a training of pas-image"
    )
    parser.add_argument(
        "--base",
        required=True,
        metavar="DIR",
        help="Stable Diffusion 1.5, with vae, text_encoder and tokenizer; and unet, unless all weights were trained",
    )
    parser.add_argument(
        "--history-level",
        type=_command.whole_number,
        default=HISTORY_LEVEL,
        metavar="T",
        help=f"noise level of reference frames, 0 (none) to 999 (default: {HISTORY_LEVEL}, as in the training)",
    )
    parser.add_argument(
        "--seed", type=_command.whole_number, default=0, metavar="N", help="seed of this noise (default: 0)"
    )
    _command.add_options(parser)
    return parser


def notices(hello: Hello, training: Training) -> list[str]:
    """Differences to the inputs that the network was trained with, as sentences."""
    found = hello.window, hello.size, hello.rig.fps
    if found == tuple(training):
        return []
    texts = [f"{frames} frames of {size[0]}x{size[1]} at {fps:g} per second" for frames, size, fps in (training, found)]
    return [f"the weights were trained with {texts[0]}, found {texts[1]}"]


def _serve(options: argparse.Namespace, source: BufferedIOBase, out: BufferedIOBase) -> None:
    device = _command.device_of(options.device)
    # Imports transformers.
    from .denoiser import Denoiser, Models

    _command.silence()
    models = Models.load(options.weights, options.base, dtype=_command.DTYPES[options.dtype], device=device)
    prediction = models.network.config.prediction

    def create(hello: Hello) -> Denoiser:
        denoiser = Denoiser(
            models,
            hello.rig,
            cached_frames=2 * hello.window if options.cached_frames is None else options.cached_frames,
            history_level=options.history_level,
            seed=options.seed,
        )
        denoiser.latent_shape(hello.size)  # refuses sizes before the notices
        for notice in notices(hello, models.training):
            print(f"{_PROGRAM}: {notice}", file=sys.stderr)
        return denoiser

    _protocol.serve(source, out, Sampling(f"ddim_{prediction}", "ddim", prediction), create)


if __name__ == "__main__":
    sys.exit(main())
