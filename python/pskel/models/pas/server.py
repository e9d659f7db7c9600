"""The video network as a server of the denoiser protocol (docs/src/reference/denoiser.md)."""

from __future__ import annotations

import sys
from io import BufferedIOBase
from typing import TextIO

from .. import _protocol
from .._protocol import Hello, Sampling
from .._rig import CameraNumbers
from .denoiser import Denoiser, Models

__all__ = ["notices", "serve"]

_SAMPLING = Sampling("flow_match", "flow_match", "velocity")


def serve(
    source: BufferedIOBase,
    out: BufferedIOBase,
    models: Models,
    *,
    cached_frames: int | None = None,
    camera_numbers: CameraNumbers | None = None,
    log: TextIO | None = None,
) -> None:
    """Answer the messages of a generator until it closes the stream.

    ``cached_frames`` (by default twice the window) and ``camera_numbers``: see ``Denoiser``. ``log`` receives notices
    (by default standard error). Raises ``ValueError`` for messages and requests that the network cannot answer.
    """

    def create(hello: Hello) -> Denoiser:
        frames = 2 * hello.window if cached_frames is None else cached_frames
        denoiser = Denoiser(models, hello.rig, cached_frames=frames, camera_numbers=camera_numbers)
        denoiser.latent_shape(hello.size)  # refuses sizes before the notices
        for notice in notices(hello):
            print(f"pskel.models.pas: {notice}", file=sys.stderr if log is None else log)
        return denoiser

    _protocol.serve(source, out, _SAMPLING, create)


def notices(hello: Hello) -> list[str]:
    """Differences to the inputs that the network was trained with, as sentences."""
    known = hello.rig.published
    if known is None:
        names = ", ".join(hello.rig.cameras)
        return [f"no checkpoint was published for the cameras {names}; they are taken as a ring in this order"]
    expected, found = (known.frames, known.fps, known.size), (hello.window, hello.rig.fps, hello.size)
    if expected == found:
        return []
    texts = [f"{frames} frames of {size[0]}x{size[1]} at {fps:g} per second" for frames, fps, size in (expected, found)]
    return [f"the published {known.name} checkpoint was trained with {texts[0]}, found {texts[1]}"]
