"""Exponential moving average of the weights of a module."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from .parallel import local

__all__ = ["Ema"]


class Ema:
    """Averages of the trained parameters of a module, which may be sharded. Buffers are not averaged.

    The decay of step n, from 0 on, is ``min(decay, (1 + n) / (10 + n))``, so that the average does not remember the
    first weights.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self._parameters = {name: local(p.data) for name, p in module.named_parameters() if p.requires_grad}
        self.averages: dict[str, Tensor] = {name: p.clone() for name, p in self._parameters.items()}

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Add the weights after a step, numbered from 0."""
        decay = min(self.decay, (1 + step) / (10 + step))
        torch._foreach_lerp_(list(self.averages.values()), list(self._parameters.values()), 1 - decay)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Exchange the weights and their averages for a while."""
        self._exchange()
        try:
            yield
        finally:
            self._exchange()

    @torch.no_grad()
    def _exchange(self) -> None:
        for name, average in self.averages.items():
            weights = average.clone()
            average.copy_(self._parameters[name])
            self._parameters[name].copy_(weights)

    @torch.no_grad()
    def load(self, averages: dict[str, Tensor]) -> None:
        """Restore ``averages``."""
        for name, average in self.averages.items():
            average.copy_(averages[name])
