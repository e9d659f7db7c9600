"""Messages of the denoiser protocol: a length, then a file of safetensors."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from io import BufferedIOBase
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Message", "read", "write"]

_Array = np.ndarray[Any, np.dtype[np.float32]]
_LENGTH = struct.Struct("<Q")
_MAX_BYTES = 1 << 35
_TEXTS = "__metadata__"


class Message(NamedTuple):
    """Texts and tensors (``float32``) of a message."""

    texts: dict[str, str]
    tensors: dict[str, _Array]


def read(stream: BufferedIOBase) -> Message | None:
    """Read a message; returns ``None`` at the end of the stream.

    Raises ``ValueError`` if the stream ends within a message, or if it is not a file of safetensors with tensors of F32.
    """
    prefix = _exactly(stream, _LENGTH.size)
    if not prefix:
        return None
    (length,) = _LENGTH.unpack(prefix)
    if length > _MAX_BYTES:
        raise ValueError(f"expected a message of at most {_MAX_BYTES} bytes, found {length}")
    content = _exactly(stream, length)
    if len(content) < length:
        raise ValueError(f"expected a message of {length} bytes, found the end after {len(content)}")
    try:
        return _parsed(content)
    except (AttributeError, KeyError, TypeError, ValueError, struct.error) as error:
        raise ValueError(f"expected a message of safetensors with tensors of F32, found {length} bytes: {error}") from error


def write(stream: BufferedIOBase, texts: Mapping[str, str], tensors: Mapping[str, _Array]) -> None:
    """Write a message, and flush the stream."""
    header: dict[str, Any] = {_TEXTS: dict(texts)}
    begin = 0
    for name, tensor in tensors.items():
        header[name] = {"dtype": "F32", "shape": tensor.shape, "data_offsets": [begin, begin + tensor.nbytes]}
        begin += tensor.nbytes
    encoded = json.dumps(header).encode()
    encoded += b" " * (-len(encoded) % _LENGTH.size)
    stream.write(_LENGTH.pack(_LENGTH.size + len(encoded) + begin) + _LENGTH.pack(len(encoded)) + encoded)
    for tensor in tensors.values():
        stream.write(np.ascontiguousarray(tensor, "<f4").tobytes())
    stream.flush()


def _exactly(stream: BufferedIOBase, length: int) -> bytearray:
    """Read ``length`` bytes, or less at the end of the stream."""
    content, filled = bytearray(length), 0
    with memoryview(content) as view:
        while filled < length and (count := stream.readinto(view[filled:])):
            filled += count
    del content[filled:]
    return content


def _parsed(content: bytearray) -> Message:
    begin = _LENGTH.size + _LENGTH.unpack_from(content)[0]
    header = json.loads(content[_LENGTH.size : begin])
    texts = header.pop(_TEXTS, {})
    return Message({name: str(text) for name, text in texts.items()}, {n: _array(t, content, begin) for n, t in header.items()})


def _array(described: Mapping[str, Any], content: bytearray, begin: int) -> _Array:
    if described["dtype"] != "F32":
        raise ValueError(f"a tensor of {described['dtype']}")
    first, last = described["data_offsets"]
    if not 0 <= first <= last <= len(content) - begin:
        raise ValueError(f"a tensor at {first} to {last}")
    values = np.frombuffer(content, "<f4", (last - first) // 4, begin + first)
    return np.require(values, np.float32, "A").reshape(described["shape"])
