"""Features of videos on disk, so that an interrupted run continues and a second run reads them."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from .._whole import write_whole
from .images import Video


class FeatureCache:
    """NPY files of the features of a network, named by a digest of weights and images.

    The name of a file depends on all that its features depend on, so files are never out of date.
    """

    def __init__(self, folder: Path, network: str, weights: str | os.PathLike[str]) -> None:
        """Use files in `folder`, which is created; `weights` is the file of the network's weights."""
        self._folder = folder
        self._network = network
        self._weights = digest_of_file(Path(weights))

    def get(self, video: Video, starts: Sequence[int], frames: int, compute: Callable[[], np.ndarray]) -> np.ndarray:
        """Return the features of a video's clips of `frames` frames, one row per start; computed if they are not there."""
        digest = hashlib.sha256(f"{self._network} {self._weights} {video.size} {frames} {list(starts)}".encode())
        for path in video.paths:
            digest.update(digest_of_file(path).encode())
        path = self._folder / f"{self._network}-{digest.hexdigest()[:32]}.npy"
        with contextlib.suppress(FileNotFoundError, ValueError, EOFError):
            found: np.ndarray = np.load(path)
            return found
        features = compute()
        self._folder.mkdir(parents=True, exist_ok=True)
        save_whole(path, features)
        return features


def save_whole(path: Path, values: np.ndarray) -> None:
    """Write an NPY file as a whole."""
    buffer = io.BytesIO()
    np.save(buffer, values)
    write_whole(path, buffer.getvalue())


def digest_of_file(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits; raises ValueError if it cannot be read."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while part := file.read(1 << 20):
                digest.update(part)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from error
    return digest.hexdigest()
