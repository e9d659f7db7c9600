"""The video diffusion network of *Point as Skeleton*: Stable Diffusion 3.5 Medium for several cameras and frames.

``load`` reads a published checkpoint, ``Network.encode_conditions`` encodes the conditions of frames once, and ``Network``
predicts the velocity of their noisy latents. ``added_time_ids`` computes the camera and motion numbers it needs.
"""

try:
    import diffusers  # noqa: F401
    import safetensors  # noqa: F401
    import torch  # noqa: F401
except ImportError as error:
    raise ImportError("pskel.models.pas needs PyTorch, diffusers and safetensors: pip install 'pskel[pas]'") from error

from .checkpoint import load
from .config import AdapterConfig, Config
from .ids import added_time_ids
from .network import Conditions, Network

__all__ = ["AdapterConfig", "Conditions", "Config", "Network", "added_time_ids", "load"]
