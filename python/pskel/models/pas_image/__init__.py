"""The image variant of *Point as Skeleton*: Stable Diffusion 1.5 for several cameras and a window of two frames.

No weights of it are published. ``pskel.train`` trains it (network ``pas-image``), ``load`` reads what was trained, and
``Network`` predicts the noise of latents. ``Denoiser`` is the network with its autoencoder and text encoder
(``Models``) as the function of ``pskel.ResetAndRoll``; ``python -m pskel.models.pas_image`` serves it to ``pskel
simulate --generator process:..``.
"""

import sys
from typing import TYPE_CHECKING, Any

try:
    import diffusers  # noqa: F401
    import safetensors  # noqa: F401
    import torch  # noqa: F401
except ImportError as error:
    _MESSAGE = f"{__name__} needs PyTorch, diffusers and safetensors: pip install 'pskel[pas]'"
    if sys.argv[:1] == ["-m"] and __name__ in sys.orig_argv:  # run as a command, which has not begun yet
        sys.exit(f"{__name__}: {_MESSAGE}")
    raise ImportError(_MESSAGE) from error

from .._condition import FrameCondition
from .._rig import Rig
from .checkpoint import load
from .config import Config
from .network import Conditions, Network

if TYPE_CHECKING:
    from .denoiser import Denoiser, Models

__all__ = ["Conditions", "Config", "Denoiser", "FrameCondition", "Models", "Network", "Rig", "load"]


def __getattr__(name: str) -> Any:
    if name in ("Denoiser", "Models"):  # need transformers, unlike the network
        from . import denoiser

        return getattr(denoiser, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
