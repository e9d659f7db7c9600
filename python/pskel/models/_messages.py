"""Messages of the denoiser protocol: a length, then a file of safetensors."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from io import BufferedIOBase
from typing import Any, NamedTuple

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

__all__ = ["Message", "read", "write"]

_Array = np.ndarray[Any, np.dtype[np.float32]]
_LENGTH = struct.Struct("<Q")
_MAX_BYTES = 1 << 35


class Message(NamedTuple):
    """Texts and tensors (``float32``) of a message."""

    texts: dict[str, str]
    tensors: dict[str, _Array]


def read(stream: BufferedIOBase) -> Message | None:
    """Read a message; returns ``None`` at the end of the stream.

    Raises ``ValueError`` if the stream ends within a message, or if it is not a file of safetensors with tensors of
    F32.
    """
    prefix = _exactly(stream, _LENGTH.size)
    if not prefix:
        return None
    if len(prefix) < _LENGTH.size:
        raise ValueError(f"expected the length of a message in {_LENGTH.size} bytes, found the end after {len(prefix)}")
    (length,) = _LENGTH.unpack(prefix)
    if length > _MAX_BYTES:
        raise ValueError(f"expected a message of at most {_MAX_BYTES} bytes, found {length}")
    content = _exactly(stream, length)
    if len(content) < length:
        raise ValueError(f"expected a message of {length} bytes, found the end after {len(content)}")
    try:
        tensors = load(content)
    except (SafetensorError, KeyError) as error:
        raise ValueError(
            f"expected a message of safetensors with tensors of F32, found {length} bytes: {error}"
        ) from error
    for name, tensor in tensors.items():
        if tensor.dtype != np.float32:
            raise ValueError(f"expected a message of safetensors with tensors of F32, found {name} of {tensor.dtype}")
    header = json.loads(content[_LENGTH.size : _LENGTH.size + _LENGTH.unpack_from(content)[0]])
    return Message(header.get("__metadata__", {}), tensors)


def write(stream: BufferedIOBase, texts: Mapping[str, str], tensors: Mapping[str, _Array]) -> None:
    """Write a message, and flush the stream."""
    content = save({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}, dict(texts))
    stream.write(_LENGTH.pack(len(content)))
    stream.write(content)
    stream.flush()


def _exactly(stream: BufferedIOBase, length: int) -> bytes:
    """Read ``length`` bytes, or less at the end of the stream."""
    parts = []
    while length > 0 and (part := stream.read(length)):
        parts.append(part)
        length -= len(part)
    return b"".join(parts)
