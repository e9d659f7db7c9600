"""Files of captions."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import DataError, first_line

if TYPE_CHECKING:
    import pskel

__all__ = ["content_of", "read_captions"]


@lru_cache(maxsize=1)
def read_captions(path: str) -> pskel.Captions:
    """Read a file, once in a process. Raises ``DataError``."""
    import pskel

    try:
        return pskel.Captions(path)
    except pskel.Error as error:
        raise DataError(first_line(error)) from error


@lru_cache(maxsize=1)
def content_of(path: str | None) -> str | None:
    """Return a digest of a file's content; ``None`` without a file."""
    return None if path is None else hashlib.sha256(Path(path).read_bytes()).hexdigest()[:32]
