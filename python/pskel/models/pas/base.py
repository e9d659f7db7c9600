"""Folder of Stable Diffusion 3.5: which files of it are read."""

from __future__ import annotations

import os
from pathlib import Path

from .._files import MODEL, TOKENIZER, expect_folder

__all__ = ["expect_base"]

_FILES: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...] = (
    *((folder, MODEL) for folder in ("vae", "text_encoder", "text_encoder_2", "text_encoder_3")),
    ("tokenizer", TOKENIZER),
    ("tokenizer_2", TOKENIZER),
    ("tokenizer_3", (("tokenizer.json", "spiece.model"),)),
)


def expect_base(base: str | os.PathLike[str]) -> Path:
    """Check that the files to read are there; returns the folder.

    Raises ``ValueError``, which names the first missing file, and the folder.
    """
    return expect_folder(base, "Stable Diffusion 3.5", _FILES)
