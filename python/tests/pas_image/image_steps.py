"""Training steps of the image variant on clips of the tests."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from image_base import clip
from pskel.models.pas_image.task import ImageTask, task
from pskel.train.config import TrainOptions

__all__ = ["CPU", "SIZE", "VIEWS", "modules", "prepared", "steps"]

CPU = torch.device("cpu")
SIZE = (32, 56)
VIEWS = 2


def prepared(base: Path, **options: Any) -> ImageTask:
    torch.manual_seed(1)
    made = task({"base": str(base), **options}, TrainOptions())
    made.prepare(iter([clip(views=VIEWS, size=SIZE)]))
    return made


def modules(made: ImageTask) -> dict[str, Any]:
    return {player.name: player.module for player in made.players}


def steps(made: ImageTask, optimizer: Any, numbers: range, clips: Sequence[Any] | None = None) -> list[float]:
    """Take training steps; returns the losses."""
    losses = []
    for number in numbers:
        batch = made.draw([clip(0, views=VIEWS, size=SIZE)] * 2 if clips is None else clips, number, 0, 0)
        loss, _ = made.loss("network", batch, modules(made), CPU)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(made.network.parameters(), 1.0)
        optimizer.step()
        losses.append(float(loss.detach()))
    return losses
