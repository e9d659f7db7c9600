"""Dimensions of the network, as they stand in the header of its weights."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import Any

CELL = 16
"""Side of the pixels that share a place of the latents."""
WORK = 4
"""Side of the pixels that share a pixel of the size at which latents are denoised."""
TOKEN = 32
"""Side of the pixels that share a token."""
PLANES = 16
"""Numbers of a pixel, see ``inputs``."""
LATENT_CHANNELS = 3
LANES = 16
"""All numbers of channels are multiples of this."""
MAX_CAMERAS = 8


def default_recipe() -> dict[str, Any]:
    """Return how conditions are rendered; the keys are as in the denoiser protocol."""
    return {
        "drawn": "256x448",
        "size": "256x448",
        "splat": "15:1,100:0",
        "color_filter": "bilinear",
    }


@dataclass(frozen=True)
class SmallConfig:
    """Dimensions of the network."""

    recipe: dict[str, Any] = field(default_factory=default_recipe)
    """How its conditions are rendered; images are of ``recipe["size"]``."""
    frames: int = 4
    """Frames in a training window, L; the network also accepts fewer."""
    encoder: tuple[int, int, int, int] = (16, 32, 64, 96)
    """Channels of the encoder at 1/4, 1/8, 1/16 and 1/32 of the size."""
    decoder: tuple[int, int, int, int] = (32, 64, 96, 160)
    """Channels of the decoder at 1/2, 1/4, 1/8 and 1/16 of the size."""
    width: int = 128
    """Width of the tokens, d."""
    head: int = 32
    """Width of a head."""
    hidden: int = 256
    """Width of the hidden layers."""
    blocks: str = "svtsvt"
    """Attention of each block: within an image (s), along a row across cameras (v), over time at a place (t)."""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images."""
        height, width = self.recipe["size"].split("x")
        return int(height), int(width)

    def to_json(self) -> dict[str, Any]:
        """Return the form of the header."""
        return {**asdict(self), "blocks": list(self.blocks)}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> SmallConfig:
        """Return the configuration of a header. Raises ``ValueError`` for unknown keys."""
        if unknown := sorted(set(values) - {each.name for each in fields(cls)}):
            raise ValueError(f"expected keys of {cls.__name__}, found {unknown[0]}")
        changed: dict[str, Any] = {name: tuple(values[name]) for name in ("encoder", "decoder") if name in values}
        if "blocks" in values:
            changed["blocks"] = "".join(values["blocks"])
        return cls(**{**values, **changed})
