"""Folders of published models: which files must be there."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

__all__ = ["MODEL", "TOKENIZER", "expect_folder", "first_line"]

MODEL: tuple[tuple[str, ...], ...] = (("config.json",), ("*.safetensors", "*.bin"))
"""Files of a model: of each tuple of patterns, one."""
TOKENIZER: tuple[tuple[str, ...], ...] = (("tokenizer.json", "vocab.json"),)
"""Files of a tokenizer."""


def expect_folder(
    base: str | os.PathLike[str], title: str, files: Sequence[tuple[str, tuple[tuple[str, ...], ...]]]
) -> Path:
    """Check that the files to read are there; returns the folder.

    ``files`` are pairs of a sub-folder ("." for the folder itself) and of patterns; each tuple of patterns must match one file. Raises
    ``ValueError``, which names the first missing file, and the folder. ``title`` is the model's name.
    """
    root = Path(base)
    if not root.is_dir():
        raise ValueError(f"expected a folder of {title}, found none: {root}")
    for folder, needed in files:
        if not (root / folder).is_dir():
            raise ValueError(f"expected a folder of {title} with {folder}, found none: {root}")
        for names in needed:
            if not any(any((root / folder).glob(name)) for name in names):
                texts = " or ".join(str(Path(folder, name)) for name in names)
                raise ValueError(f"expected a folder of {title} with {texts}, found none: {root}")
    return root


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, or its type if it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
