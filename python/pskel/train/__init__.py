"""Training of image generators in PyTorch: ``python -m pskel.train CONFIG --data .. --out DIR``.

The harness reads clips, steps optimizers, and writes checkpoints, losses, pictures and weights. A ``Task`` knows the
network: ``pskel.models.NETWORK.task`` has the function ``task``. ``Config`` is the content of CONFIG, ``train`` runs
it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .config import Config, DataOptions, TrainOptions
from .errors import CheckpointError, ConfigError, DataError, LossError, TrainError

if TYPE_CHECKING:
    from .clip import Clip
    from .loop import train
    from .task import Player, Task

__all__ = [
    "CheckpointError",
    "Clip",
    "Config",
    "ConfigError",
    "DataError",
    "DataOptions",
    "LossError",
    "Player",
    "Task",
    "TrainError",
    "TrainOptions",
    "train",
]

_LAZY = {"Clip": "clip", "Player": "task", "Task": "task", "train": "loop"}
"""Names of modules that need PyTorch."""


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_LAZY[name]}", __name__), name)
