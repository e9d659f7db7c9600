"""Prompts: the three text encoders of Stable Diffusion 3.5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from .base import first_line

try:
    from transformers import CLIPTextModelWithProjection, CLIPTokenizer, T5EncoderModel, T5TokenizerFast
except ImportError as error:
    raise ImportError("the denoiser of pskel.models.pas needs transformers: pip install 'pskel[pas]'") from error

__all__ = ["TOKENS", "TextEncoder"]

TOKENS = 77
"""Tokens of each text encoder; longer prompts are truncated."""


class TextEncoder:
    """Encodes prompts as Stable Diffusion 3.5 does (arXiv:2403.03206), with 77 tokens of T5.

    The encoders are in main memory; each is on the device only while it encodes.
    """

    def __init__(self, tokenizers: list[Any], encoders: list[Any], device: str | torch.device = "cpu") -> None:
        self.tokenizers = tokenizers
        self.encoders = [encoder.eval() for encoder in encoders]
        self.device = torch.device(device)

    @classmethod
    def load(
        cls,
        base: Path,
        *,
        channels: int,
        pooled_channels: int,
        dtype: torch.dtype = torch.float32,
        device: str | torch.device = "cpu",
    ) -> TextEncoder:
        """Read the encoders and tokenizers from a Stable Diffusion 3.5 folder.

        Raises ``ValueError``, which names the folder, if they cannot be read or have other numbers of channels.
        """
        clip, t5 = (CLIPTokenizer, CLIPTextModelWithProjection), (T5TokenizerFast, T5EncoderModel)
        tokenizers, encoders = [], []
        for suffix, (tokenizer, encoder) in zip(("", "_2", "_3"), (clip, clip, t5)):
            tokenizers.append(_read(tokenizer, base / f"tokenizer{suffix}"))
            encoders.append(_read(encoder, base / f"text_encoder{suffix}", torch_dtype=dtype))
        first, second, third = (encoder.config for encoder in encoders)
        if third.d_model != channels or first.hidden_size + second.hidden_size > channels:
            found = f"{first.hidden_size} + {second.hidden_size} and {third.d_model}"
            raise ValueError(f"expected text encoders of at most {channels} and of {channels} channels, found {found}: {base}")
        if first.projection_dim + second.projection_dim != pooled_channels:
            found = f"{first.projection_dim} + {second.projection_dim}"
            raise ValueError(f"expected text encoders of {pooled_channels} pooled channels, found {found}: {base}")
        return cls(tokenizers, encoders, device)

    def __call__(self, prompt: str) -> tuple[Tensor, Tensor]:
        """Encode a prompt.

        Returns tokens ``[154, D]``, of CLIP-L and CLIP-G side by side, padded with zeros to the D channels of T5, then of T5;
        and the pooled tokens of CLIP-L and CLIP-G, ``[P]``.
        """
        with torch.inference_mode():
            first, second = (self._run(i, prompt, output_hidden_states=True) for i in (0, 1))
            t5 = self._run(2, prompt)[0]
            clip = torch.cat([first.hidden_states[-2], second.hidden_states[-2]], dim=-1)
            tokens = torch.cat([pad(clip, (0, t5.shape[-1] - clip.shape[-1])), t5], dim=-2)
            return tokens[0], torch.cat([first[0], second[0]], dim=-1)[0]

    def _run(self, index: int, prompt: str, **options: Any) -> Any:
        tokens = self.tokenizers[index](
            [prompt], padding="max_length", max_length=TOKENS, truncation=True, return_tensors="pt"
        )
        encoder = self.encoders[index].to(self.device)
        try:
            return encoder(tokens.input_ids.to(self.device), **options)
        finally:
            encoder.to("cpu")


def _read(kind: Any, folder: Path, **options: Any) -> Any:
    try:
        return kind.from_pretrained(folder, local_files_only=True, **options)
    except Exception as error:  # of many kinds, by what the files are
        raise ValueError(f"expected a {kind.__name__}, found {first_line(error)}: {folder}") from error
