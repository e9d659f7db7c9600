"""Bounded cache."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

__all__ = ["Cache"]

_Value = TypeVar("_Value")


class Cache(Generic[_Value]):
    """Keeps the ``capacity`` values that were used last; with 0, none."""

    def __init__(self, capacity: int) -> None:
        if capacity < 0:
            raise ValueError(f"expected a cache of 0 or more values, found {capacity}")
        self.capacity = capacity
        self._values: OrderedDict[Hashable, _Value] = OrderedDict()

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: Hashable, compute: Callable[[], _Value]) -> _Value:
        """Return the value of a key, which is computed if it is not there."""
        value = self._values.pop(key) if key in self._values else compute()
        self._values[key] = value
        if len(self._values) > self.capacity:
            self._values.popitem(last=False)
        return value
