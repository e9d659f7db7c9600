"""Texts of messages, converted and checked. Each function raises ``ValueError``, which names a missing or wrong text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

__all__ = ["is_size", "joined", "listed", "number", "pair", "text", "whole"]


def text(texts: Mapping[str, str], name: str, where: str = "the hello") -> str:
    """Return a text; ``where`` names its message in the error."""
    if name not in texts:
        raise ValueError(f"expected the text {name} in {where}, found none (is pskel older than this package?)")
    return texts[name]


def whole(texts: Mapping[str, str], name: str, where: str = "the hello") -> int:
    """Return a text of decimal digits as a number."""
    digits = text(texts, name, where)
    if not (digits.isascii() and digits.isdecimal()):
        raise ValueError(f"expected {name} as a whole number in {where}, found {digits[:200]!r}")
    return int(digits)


def number(texts: Mapping[str, str], name: str, where: str = "the hello") -> float:
    """Return a text as a finite number."""
    found = text(texts, name, where)
    try:
        value = float(found)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"expected {name} as a number in {where}, found {found[:200]!r}")
    return value


def pair(texts: Mapping[str, str], name: str, where: str = "the hello") -> tuple[int, int]:
    """Return a text ``H,W`` as height and width."""
    sides = text(texts, name, where).split(",")
    if len(sides) != 2 or not all(side.isascii() and side.isdecimal() for side in sides):
        raise ValueError(f"expected {name} H,W in {where}, found {texts[name][:200]!r}")
    return int(sides[0]), int(sides[1])


def listed(texts: Mapping[str, str], name: str, where: str = "the hello") -> list[Any]:
    """Return a text of a JSON list."""
    found = text(texts, name, where)
    try:
        values = json.loads(found)
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, list):
        raise ValueError(f"expected {name} as a list in {where}, found {found[:200]}")
    return values


def is_size(value: Any) -> bool:
    """Whether a value is a list of width and height."""
    return isinstance(value, list) and len(value) == 2 and all(type(side) is int and side > 0 for side in value)


def joined(numbers: tuple[int, ...]) -> str:
    """Return numbers as a text with commas."""
    return ",".join(map(str, numbers))
