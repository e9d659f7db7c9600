"""Prompts: the three text encoders of Stable Diffusion 3.5."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch.nn.functional import pad

from .._files import first_line

try:
    from transformers import CLIPTextModelWithProjection, CLIPTokenizer, T5EncoderModel, T5TokenizerFast
except ImportError as error:
    raise ImportError("the denoiser of pskel.models.pas needs transformers: pip install 'pskel[pas]'") from error

__all__ = ["TOKENS", "TextEncoder"]

TOKENS = 77
"""Tokens of each text encoder; longer prompts are truncated."""

_Picked = TypeVar("_Picked")


class TextEncoder:
    """Encodes prompts as Stable Diffusion 3.5 does (arXiv:2403.03206), with 77 tokens of T5.

    The encoders are in main memory; each is on the device only while it encodes, unless ``stays_on_device``.
    """

    def __init__(
        self,
        tokenizers: list[Any],
        encoders: list[Any],
        device: str | torch.device = "cpu",
        *,
        stays_on_device: bool = False,
    ) -> None:
        self.tokenizers = tokenizers
        self.encoders = [encoder.eval() for encoder in encoders]
        self.device = torch.device(device)
        self.stays_on_device = stays_on_device

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
        return self.encode_all([prompt])[0]

    def encode_all(self, prompts: Sequence[str]) -> list[tuple[Tensor, Tensor]]:
        """Encode prompts one by one, so that a result does not depend on the others; see a call."""
        with torch.inference_mode():
            first, second = (self._run(i, prompts, _clip_tokens, output_hidden_states=True) for i in (0, 1))
            return [_joined(*outputs) for outputs in zip(first, second, self._run(2, prompts, _t5_tokens))]

    def _run(self, index: int, prompts: Sequence[str], pick: Callable[[Any], _Picked], **options: Any) -> list[_Picked]:
        encoder = self.encoders[index].to(self.device)
        try:
            return [pick(encoder(self._tokens(index, prompt), **options)) for prompt in prompts]
        finally:
            if not self.stays_on_device:
                encoder.to("cpu")

    def _tokens(self, index: int, prompt: str) -> Tensor:
        tokenizer = self.tokenizers[index]
        tokens = tokenizer([prompt], padding="max_length", max_length=TOKENS, truncation=True, return_tensors="pt")
        ids: Tensor = tokens.input_ids.to(self.device)
        return ids


def _clip_tokens(output: Any) -> tuple[Tensor, Tensor]:
    """Tokens before the last layer, and pooled tokens."""
    return output.hidden_states[-2], output[0]


def _t5_tokens(output: Any) -> Tensor:
    tokens: Tensor = output[0]
    return tokens


def _joined(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor], t5: Tensor) -> tuple[Tensor, Tensor]:
    """Tokens ``[154, D]`` and pooled tokens ``[P]``, see ``TextEncoder.__call__``."""
    clip = torch.cat([first[0], second[0]], dim=-1)
    tokens = torch.cat([pad(clip, (0, t5.shape[-1] - clip.shape[-1])), t5], dim=-2)
    return tokens[0], torch.cat([first[1], second[1]], dim=-1)[0]


def _read(kind: Any, folder: Path, **options: Any) -> Any:
    try:
        return kind.from_pretrained(folder, local_files_only=True, **options)
    except Exception as error:  # of many kinds, by what the files are
        raise ValueError(f"expected a {kind.__name__}, found {first_line(error)}: {folder}") from error
