"""Configuration of the network, as it is in the header of its weights."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

__all__ = ["HISTORY_LEVEL", "LATENT_SCALE", "TEXT_TOKENS", "TINY", "Config", "Prediction", "Trained"]

Prediction = Literal["epsilon", "velocity"]
"""Output of the network: the noise, or ``sqrt(a) noise - sqrt(1 - a) latents``."""
Trained = Literal["all", "adapters", "lora"]
"""Trained weights: all; or the adapters, the blocks across cameras and frames, and the view embedding; or these and
LoRA matrices."""

LATENT_SCALE = 8
"""Pixels per latent, in height and width."""
TEXT_TOKENS = 77
"""Tokens of a prompt; longer ones are truncated."""
HISTORY_LEVEL = 100
"""Default noise level of reference frames at inference, within those of the training."""

_CHOICES: Mapping[str, tuple[str, ...]] = {
    "depth": ("continuous", "both"),
    "prediction": ("epsilon", "velocity"),
    "trained": ("all", "adapters", "lora"),
}


@dataclass(frozen=True)
class Config:
    """Sizes of the network and the rules of its training. The defaults are the sizes of Stable Diffusion 1.5.

    Raises ``ValueError`` for sizes that do not fit each other.
    """

    block_out_channels: tuple[int, ...] = (320, 640, 1280, 1280)
    layers_per_block: int = 2
    attention_head_dim: int = 8
    """Number of heads of each attention; the name is the one of diffusers' configurations."""
    cross_attention_dim: int = 768
    """Channels of the text tokens."""
    norm_num_groups: int = 32
    in_channels: int = 4
    """Channels of the latents."""
    depth: Literal["continuous", "both"] = "continuous"
    """``both``: sines and cosines of the depth bins fill the last 16 of the points' channels, which are 0 otherwise."""
    depth_bins: int = 256
    """Number of depth bins in the points."""
    prediction: Prediction = "epsilon"
    zero_snr: bool = False
    """Whether the last step of the noise table is noise alone (arXiv:2305.08891). Needs ``prediction`` ``velocity``."""
    trained: Trained = "all"
    lora_rank: int = 0
    """Rank of the LoRA matrices, above 0 with ``trained`` ``lora`` alone."""

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise ValueError(f"expected {name} of {', '.join(choices)}, found {getattr(self, name)!r}")
        least = {"depth_bins": 3, "lora_rank": 0}  # 3: octaves of a logarithm above 1
        for name, value in vars(self).items():
            if type(value) is int and value < least.get(name, 1):
                raise ValueError(f"expected {name} of at least {least.get(name, 1)}, found {value}")
        channels = list(self.block_out_channels)
        if len(channels) < 2:
            raise ValueError(f"expected block_out_channels of at least 2 sizes, found {channels}")
        for name in ("attention_head_dim", "norm_num_groups"):
            if wrong := [count for count in channels if count < 1 or count % getattr(self, name)]:
                raise ValueError(
                    f"expected block_out_channels in multiples of {name} {getattr(self, name)}, found {wrong[0]}"
                )
        if self.zero_snr and self.prediction != "velocity":
            raise ValueError(f"expected prediction velocity with zero_snr, found {self.prediction}")
        if (self.trained == "lora") != (self.lora_rank > 0):
            raise ValueError(
                f"expected lora_rank above 0 for trained lora alone, found {self.lora_rank} for {self.trained}"
            )

    @property
    def time_channels(self) -> int:
        """Channels of the time embedding."""
        return 4 * self.block_out_channels[0]

    @property
    def unet(self) -> dict[str, Any]:
        """Arguments of ``UNet2DConditionModel``; all others have diffusers' defaults."""
        deeper = len(self.block_out_channels) - 1
        return {
            "in_channels": self.in_channels,
            "out_channels": self.in_channels,
            "down_block_types": ("CrossAttnDownBlock2D",) * deeper + ("DownBlock2D",),
            "up_block_types": ("UpBlock2D",) + ("CrossAttnUpBlock2D",) * deeper,
            "block_out_channels": self.block_out_channels,
            "layers_per_block": self.layers_per_block,
            "attention_head_dim": self.attention_head_dim,
            "cross_attention_dim": self.cross_attention_dim,
            "norm_num_groups": self.norm_num_groups,
        }

    def to_json(self) -> str:
        """Return the form of the header."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def parse(cls, values: Any, source: str = "configuration") -> Config:
        """Convert a parsed JSON object; missing keys have the default value.

        Raises ``ValueError``, which names the key and ``source``, for an unknown key and a value of another type.
        """
        try:
            if not isinstance(values, dict):
                raise ValueError(f"expected a JSON object, found {json.dumps(values)[:40]}")
            default = cls()
            if unknown := [key for key in values if key not in vars(default)]:
                raise ValueError(f"expected keys of the network, found {unknown[0]}")
            return replace(
                default, **{key: _converted(vars(default)[key], value, key) for key, value in values.items()}
            )
        except ValueError as error:
            raise ValueError(f"{error}: {source}") from None


def _converted(default: Any, value: Any, name: str) -> Any:
    """Convert a JSON value to the type of a default."""
    if isinstance(default, tuple):
        if isinstance(value, (list, tuple)) and all(type(element) is int for element in value):
            return tuple(value)
        raise ValueError(f"expected {name} of type list of int, found {json.dumps(value)[:40]}")
    if type(value) is not type(default):
        raise ValueError(f"expected {name} of type {type(default).__name__}, found {json.dumps(value)[:40]}")
    return value


TINY = Config(
    block_out_channels=(16, 32, 32, 32),
    layers_per_block=1,
    attention_head_dim=2,
    cross_attention_dim=24,
    norm_num_groups=8,
)
"""Sizes for tests."""
