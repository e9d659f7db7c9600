"""Messages of the denoiser and the image protocol: a length, then a file of safetensors (docs/src/reference/denoiser.md).

Needs NumPy alone, so that it works in the environments of other programs, Python 3.9 or later.
"""

from __future__ import annotations

import json
import math
import os
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BufferedIOBase
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["MAX_ANSWER_BYTES", "Message", "read", "standard_streams", "write"]

#: Types of tensors, by their names in safetensors.
TYPES = {"U8": "|u1", "U16": "<u2", "F32": "<f4", "F64": "<f8"}
#: Largest message that a generator accepts.
MAX_ANSWER_BYTES = 1 << 30
_NAMES = {kind: name for name, kind in TYPES.items()}
_LENGTH = struct.Struct("<Q")
_MAX_BYTES = 1 << 35
_PART_BYTES = 1 << 24


class Message(NamedTuple):
    """Texts and tensors of a message."""

    texts: dict[str, str]
    tensors: dict[str, npt.NDArray[Any]]


def read(stream: BufferedIOBase, types: Sequence[str] = tuple(TYPES)) -> Message | None:
    """Read a message; returns ``None`` at the end of the stream. Its tensors are writable.

    Raises ``ValueError`` if the stream ends within a message, or if it is not a file of safetensors with tensors of
    these ``types``.
    """
    prefix = _up_to(stream, _LENGTH.size)
    if not prefix:
        return None
    if len(prefix) < _LENGTH.size:
        raise ValueError(f"expected the length of a message in {_LENGTH.size} bytes, found the end after {len(prefix)}")
    (length,) = _LENGTH.unpack(prefix)
    if length > _MAX_BYTES:
        raise ValueError(f"expected a message of at most {_MAX_BYTES} bytes, found {length}")
    content = _up_to(stream, length)
    if len(content) < length:
        raise ValueError(f"expected a message of {length} bytes, found the end after {len(content)}")
    expected = f"expected a message of safetensors with tensors of {', '.join(types)}"
    try:
        texts, described, start = _header(content)
        for name, (kind, _, _) in described.items():
            if kind not in types:
                raise ValueError(f"{name} of {kind}")
        return Message(texts, {name: _tensor(content, start, *tensor) for name, tensor in described.items()})
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{expected}, found {length} bytes: {error}") from None


def write(stream: BufferedIOBase, texts: Mapping[str, str], tensors: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write a message, and flush the stream. Raises ``ValueError`` for tensors of other types than ``TYPES``."""
    header: dict[str, Any] = {"__metadata__": dict(texts)}
    parts, end = [], 0
    for name, tensor in sorted(tensors.items(), key=lambda item: -item[1].itemsize):  # each starts at a multiple of its size
        little = tensor.dtype.newbyteorder("<")
        if little.str not in _NAMES:
            raise ValueError(f"expected the tensor {name} of {', '.join(TYPES)}, found {tensor.dtype}")
        parts.append(np.ascontiguousarray(tensor, dtype=little).tobytes())
        header[name] = {"dtype": _NAMES[little.str], "shape": list(tensor.shape), "data_offsets": [end, end + len(parts[-1])]}
        end += len(parts[-1])
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % _LENGTH.size)
    stream.write(_LENGTH.pack(_LENGTH.size + len(text) + end) + _LENGTH.pack(len(text)) + text)
    for part in parts:
        stream.write(part)
    stream.flush()


@contextmanager
def standard_streams() -> Iterator[tuple[BufferedIOBase, BufferedIOBase]]:
    """Standard input, and standard output for messages alone: all other output, from Python or not, goes to standard error."""
    with open(0, "rb", closefd=False) as source, open(os.dup(1), "wb") as out:
        os.dup2(2, 1)
        sys.stdout = sys.stderr
        yield source, out


def _up_to(stream: BufferedIOBase, length: int) -> bytearray:
    """Read ``length`` bytes, or less at the end of the stream."""
    content = bytearray()
    while len(content) < length and (part := stream.read(min(length - len(content), _PART_BYTES))):
        content += part
    return content


def _header(content: bytearray) -> tuple[dict[str, str], dict[str, tuple[str, list[int], int]], int]:
    """Texts; type, shape and offset of each tensor; the start of the data. Raises ``ValueError``, which says what is wrong."""
    if len(content) < _LENGTH.size:
        raise ValueError("no header")
    (size,) = _LENGTH.unpack_from(content)
    start = _LENGTH.size + size
    if start > len(content):
        raise ValueError(f"a header of {size} bytes")
    header = json.loads(content[_LENGTH.size : start].decode(), object_pairs_hook=_unique)
    if not isinstance(header, dict):
        raise ValueError("a header that is no object")
    texts = header.pop("__metadata__", {})
    if not isinstance(texts, dict) or not all(isinstance(text, str) for text in texts.values()):
        raise ValueError("__metadata__ that is no object of texts")
    spans = {name: _span(name, tensor) for name, tensor in header.items()}
    end = 0
    for name, (_, _, first, last) in sorted(spans.items(), key=lambda item: item[1][2:]):
        if first != end:
            raise ValueError(f"{name} from byte {first} of the data, after the end of another tensor at {end}")
        end = last
    if end != len(content) - start:
        raise ValueError(f"{len(content) - start} bytes of data for tensors of {end}")
    return texts, {name: (kind, shape, first) for name, (kind, shape, first, _) in spans.items()}, start


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        raise ValueError("a key that occurs twice")
    return entries


def _span(name: str, tensor: Any) -> tuple[str, list[int], int, int]:
    """Type, shape, first byte and end of a tensor in the data; types that are not in ``TYPES`` have any size."""
    tensor = tensor if isinstance(tensor, dict) else {}
    kind, shape, offsets = (tensor.get(key) for key in ("dtype", "shape", "data_offsets"))
    if not isinstance(kind, str) or not _are_whole(shape) or not _are_whole(offsets) or len(offsets) != 2:
        raise ValueError(f"{name} without dtype, shape and data_offsets")
    first, last = offsets
    size = math.prod(shape) * np.dtype(TYPES[kind]).itemsize if kind in TYPES else last - first
    if last - first != size or size < 0:
        raise ValueError(f"{name} of {kind} {shape} in {last - first} bytes")
    return kind, shape, first, last


def _are_whole(values: Any) -> bool:
    return isinstance(values, list) and all(type(value) is int and value >= 0 for value in values)


def _tensor(content: bytearray, start: int, kind: str, shape: list[int], first: int) -> npt.NDArray[Any]:
    return np.frombuffer(content, TYPES[kind], math.prod(shape), start + first).reshape(shape)
