"""Prompts: the text encoder of Stable Diffusion 1.5."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from .._cache import Cache
from .._files import first_line
from .config import TEXT_TOKENS

try:
    from transformers import CLIPTextModel, CLIPTokenizer
except ImportError as error:
    raise ImportError("the denoiser of pskel.models.pas_image needs transformers: pip install 'pskel[pas]'") from error

__all__ = ["TextEncoder"]


class TextEncoder:
    """Encodes prompts as Stable Diffusion 1.5 does: CLIP-L, 77 tokens after its last layer.

    Tokens of the last ``cached`` prompts remain in main memory.
    """

    def __init__(self, tokenizer: Any, encoder: Any, device: str | torch.device = "cpu", *, cached: int = 1024) -> None:
        self.tokenizer = tokenizer
        self.encoder = encoder.eval().requires_grad_(False)
        self._tokens: Cache[Tensor] = Cache(cached)
        self.to(device)

    @classmethod
    def load(
        cls,
        base: Path,
        *,
        channels: int,
        dtype: torch.dtype = torch.float32,
        device: str | torch.device = "cpu",
        cached: int = 1024,
    ) -> TextEncoder:
        """Read the encoder and its tokenizer from a folder of Stable Diffusion 1.5.

        Raises ``ValueError``, which names the folder, if they cannot be read or have another number of channels.
        """
        tokenizer = _read(CLIPTokenizer, base / "tokenizer")
        encoder = _read(CLIPTextModel, base / "text_encoder", torch_dtype=dtype)
        if encoder.config.hidden_size != channels:
            found = encoder.config.hidden_size
            raise ValueError(f"expected a text encoder of {channels} channels, found {found}: {base / 'text_encoder'}")
        return cls(tokenizer, encoder, device, cached=cached)

    def to(self, device: str | torch.device) -> None:
        """Move the encoder to a device."""
        self.device = torch.device(device)
        self.encoder.to(self.device)

    def __call__(self, prompt: str) -> Tensor:
        """Encode a prompt as tokens ``[77, D]`` in main memory."""
        return self._tokens.get(prompt, lambda: self._encoded(prompt))

    def encode_all(self, prompts: Sequence[str]) -> Tensor:
        """Encode prompts one by one, so that a result does not depend on the others: ``[N, 77, D]``."""
        return torch.stack([self(prompt) for prompt in prompts])

    def _encoded(self, prompt: str) -> Tensor:
        options = {"padding": "max_length", "max_length": TEXT_TOKENS, "truncation": True, "return_tensors": "pt"}
        tokens = self.tokenizer([prompt], **options)
        with torch.no_grad(), torch.autocast(self.device.type, enabled=False):
            encoded: Tensor = self.encoder(tokens.input_ids.to(self.device))[0]
        return encoded[0].cpu()


def _read(kind: Any, folder: Path, **options: Any) -> Any:
    try:
        return kind.from_pretrained(folder, local_files_only=True, **options)
    except Exception as error:  # of many kinds, by what the files are
        raise ValueError(f"expected a {kind.__name__}, found {first_line(error)}: {folder}") from error
