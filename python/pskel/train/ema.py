"""Exponential moving average of a module's weights."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from .parallel import local

__all__ = ["Ema"]


class Ema:
    """Averages of the trained parameters of a module, ``float32``; it may be sharded. Buffers are not averaged.

    The decay of step n, from 0 on, is ``min(decay, (1 + n) / (10 + n))``, so that the first weights are forgotten.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self._parameters = {name: local(p.data) for name, p in module.named_parameters() if p.requires_grad}
        self.averages: dict[str, Tensor] = {name: p.float().clone() for name, p in self._parameters.items()}

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Add the weights after a step, numbered from 0."""
        decay = min(self.decay, (1 + step) / (10 + step))
        for name, average in self.averages.items():
            average.lerp_(self._parameters[name].float(), 1 - decay)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Put the averages in place of the weights for a while."""
        saved = self._exchange()
        try:
            yield
        finally:
            self._restore(saved)

    @torch.no_grad()
    def _exchange(self) -> dict[str, Tensor]:
        """Exchange weights and averages; returns weights in half precision, whose averages would be rounded."""
        saved = {}
        for name, weights in self._parameters.items():
            average, copy = self.averages[name], weights.clone()
            weights.copy_(average)
            if weights.dtype == average.dtype:
                average.copy_(copy)  # no memory for a second copy of all weights
            else:
                saved[name] = copy
        return saved

    @torch.no_grad()
    def _restore(self, saved: dict[str, Tensor]) -> None:
        for name, weights in self._parameters.items():
            if name in saved:
                weights.copy_(saved[name])
                continue
            average = weights.clone()
            weights.copy_(self.averages[name])
            self.averages[name].copy_(average)

    @torch.no_grad()
    def load(self, averages: dict[str, Tensor]) -> None:
        """Restore ``averages``."""
        for name, average in self.averages.items():
            average.copy_(averages[name])
