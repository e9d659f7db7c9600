"""The video diffusion network of *Point as Skeleton*: Stable Diffusion 3.5 Medium for several cameras and frames.

``load`` reads a published checkpoint, ``Network.encode_conditions`` encodes the conditions of frames once, and ``Network``
predicts the velocity of their noisy latents. ``added_time_ids`` computes the camera and motion numbers it needs.

``Denoiser`` is the network with its autoencoder and text encoders (``Models``) as the function of ``pskel.ResetAndRoll``.
``python -m pskel.models.pas`` serves it to ``pskel simulate --generator process:..``. ``python -m pskel.train`` trains it:
``task`` and ``training``; ``python -m pskel.models.pas.training.presets NAME`` prints a configuration.
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
from .config import AdapterConfig, Config
from .ids import added_time_ids
from .network import Conditions, Network

if TYPE_CHECKING:
    from .denoiser import Denoiser, Models

__all__ = [
    "AdapterConfig",
    "Conditions",
    "Config",
    "Denoiser",
    "FrameCondition",
    "Models",
    "Network",
    "Rig",
    "added_time_ids",
    "load",
]


def __getattr__(name: str) -> Any:
    if name in ("Denoiser", "Models"):  # need transformers, unlike the network
        from . import denoiser

        return getattr(denoiser, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
