"""Folder of Stable Diffusion 3.5: which files of it are read."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["expect_base", "first_line"]

_WEIGHTS = ("*.safetensors", "*.bin")
_FILES: tuple[tuple[str, tuple[str, ...]], ...] = (
    *(
        (folder, names)
        for folder in ("vae", "text_encoder", "text_encoder_2", "text_encoder_3")
        for names in (("config.json",), _WEIGHTS)
    ),
    ("tokenizer", ("tokenizer.json", "vocab.json")),
    ("tokenizer_2", ("tokenizer.json", "vocab.json")),
    ("tokenizer_3", ("tokenizer.json", "spiece.model")),
)
"""Sub-folders, and names of which one must be there."""


def expect_base(base: str | os.PathLike[str]) -> Path:
    """Check that the files to read are there; returns the folder.

    Raises ``ValueError``, which names the first missing file, and the folder.
    """
    root = Path(base)
    if not root.is_dir():
        raise ValueError(f"expected a folder of Stable Diffusion 3.5, found none: {root}")
    for folder, names in _FILES:
        if not (root / folder).is_dir():
            raise ValueError(f"expected a folder of Stable Diffusion 3.5 with {folder}, found none: {root}")
        if not any(any((root / folder).glob(name)) for name in names):
            texts = " or ".join(f"{folder}/{name}" for name in names)
            raise ValueError(f"expected a folder of Stable Diffusion 3.5 with {texts}, found none: {root}")
    return root


def first_line(error: Exception) -> str:
    """Return the first line of an error's text, or its type if it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
