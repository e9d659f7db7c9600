"""Modules in training, with their optimizers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import torch
from numpy.random import SeedSequence
from torch import Tensor, nn

from .config import TrainOptions
from .ema import Ema
from .errors import ConfigError
from .optimizer import clip_gradients, create_optimizer, named_groups, set_rates
from .parallel import Processes, lost_processes, reshard, shard_module, without_sync, wrap_step
from .task import LOGGED, Player, Task

__all__ = ["LossOf", "Players", "autocast"]


def autocast(options: TrainOptions, device: torch.device) -> torch.autocast:
    """Return the context in which losses and validations run."""
    return torch.autocast(device.type, torch.bfloat16, enabled=options.precision == "bf16")


class LossOf(NamedTuple):
    """Mean loss of a player over the batches of a step in this process, with the mean of its logged numbers."""

    loss: float
    numbers: dict[str, float]


class _Step(nn.Module):
    """The loss of a player as a module, so that DDP sees the parameters whatever the task calls."""

    def __init__(self, task: Task, player: Player, device: torch.device) -> None:
        super().__init__()
        self.module = player.module
        self._task = task
        self._name = player.name
        self._device = device

    def forward(self, batch: Any, modules: Mapping[str, nn.Module]) -> tuple[Tensor, dict[str, float]]:
        return self._task.loss(self._name, batch, modules, self._device)


class _Entry:
    """A player with its optimizer."""

    def __init__(self, task: Task, player: Player, options: TrainOptions, processes: Processes) -> None:
        self.player = player
        self.module = player.module
        self.is_sharded = options.shard == "fsdp"
        unused = bool(getattr(task, "unused_parameters", False))
        groups = named_groups(player.module, player.groups, player.name)
        player.module.to(processes.device)
        if self.is_sharded:
            shard_module(player.module, processes)
        else:
            processes.share(tensor for tensor in player.module.state_dict().values())
        self.parameters = [parameter for parameter in player.module.parameters() if parameter.requires_grad]
        self.optimizer = create_optimizer(player.module, groups, options)
        self.step = wrap_step(_Step(task, player, processes.device), processes, sharded=self.is_sharded, unused=unused)


class Players:
    """All players of a task."""

    def __init__(self, task: Task, options: TrainOptions, processes: Processes) -> None:
        self._options = options
        self._processes = processes
        self.entries = [_Entry(task, player, options, processes) for player in task.players]
        self.modules: dict[str, nn.Module] = {entry.player.name: entry.module for entry in self.entries}
        self.ema = Ema(self.entries[0].module, options.ema) if options.ema > 0 else None
        for entry in self.entries:
            entry.module.train()

    def active(self, step: int) -> list[_Entry]:
        """Return the players that are trained in a step."""
        return [entry for entry in self.entries if step >= entry.player.start]

    def learn(self, batches: Sequence[Any], step: int) -> dict[str, LossOf]:
        """Add up the gradients of all players over the batches of a step; returns their losses in this process."""
        found: dict[str, list[LossOf]] = {}
        for number, batch in enumerate(batches):
            batch = _moved(batch, self._processes.device)
            torch.manual_seed(_mixed(self._options.seed, step, self._processes.rank * len(batches) + number))
            for entry in self.active(step):
                with self._alone(entry):
                    is_last = number == len(batches) - 1
                    loss = self._backward(entry, batch, len(batches), is_last)
                found.setdefault(entry.player.name, []).append(loss)
        return {name: _mean(losses) for name, losses in found.items()}

    def _backward(self, entry: _Entry, batch: Any, batches: int, is_last: bool) -> LossOf:
        if is_last:
            return self._add_gradients(entry, batch, batches)
        with without_sync(entry.step, entry.module):
            return self._add_gradients(entry, batch, batches)

    def _add_gradients(self, entry: _Entry, batch: Any, batches: int) -> LossOf:
        with lost_processes():
            with autocast(self._options, self._processes.device):
                loss, numbers = entry.step(batch, self.modules)
            torch.autograd.backward(loss / batches)
        if wrong := [name for name in numbers if name in LOGGED]:
            raise ConfigError(f"expected numbers to log named other than {', '.join(LOGGED)}, found {wrong[0]}")
        return LossOf(float(loss.detach()), {name: float(value) for name, value in numbers.items()})

    @contextmanager
    def _alone(self, entry: _Entry) -> Iterator[None]:
        """Let the parameters of the other players need no gradients for a while."""
        others = [p for other in self.entries if other is not entry for p in other.parameters]
        for parameter in others:
            parameter.requires_grad_(False)
        try:
            yield
        finally:
            for parameter in others:
                parameter.requires_grad_(True)

    def norms(self, step: int) -> dict[str, float]:
        """Limit the gradients; returns their norms before."""
        with lost_processes():
            return {
                each.player.name: clip_gradients(each.module, self._options.clip_norm) for each in self.active(step)
            }

    def update(self, step: int) -> dict[str, float]:
        """Step all optimizers; returns the learning rates."""
        rates = {}
        for entry in self.active(step):
            rates[entry.player.name] = set_rates(entry.optimizer, self._options, step)
            entry.optimizer.step()
            entry.optimizer.zero_grad(set_to_none=True)
        if self.ema is not None:
            self.ema.update(step)
        return rates

    @contextmanager
    def evaluated(self) -> Iterator[dict[str, nn.Module]]:
        """Give the modules for evaluation, with averaged weights, for a while."""
        for entry in self.entries:
            entry.module.eval()
        try:
            if self.ema is None:
                yield self.modules
            else:
                with self.ema.applied():
                    yield self.modules
        finally:
            for entry in self.entries:
                reshard(entry.module)
                entry.module.train()


def _moved(value: Any, device: torch.device) -> Any:
    """Return tensors in tuples, lists and dictionaries on a device."""
    if isinstance(value, Tensor):
        return value.to(device, non_blocking=True)
    if isinstance(value, tuple):
        parts = [_moved(part, device) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if isinstance(value, list):
        return [_moved(part, device) for part in value]
    if isinstance(value, dict):
        return {key: _moved(part, device) for key, part in value.items()}
    return value


def _mean(losses: Sequence[LossOf]) -> LossOf:
    names = {name: None for each in losses for name in each.numbers}
    numbers = {name: [each.numbers[name] for each in losses if name in each.numbers] for name in names}
    return LossOf(
        math.fsum(each.loss for each in losses) / len(losses),
        {name: math.fsum(values) / len(values) for name, values in numbers.items()},
    )


def _mixed(*numbers: int) -> int:
    """Return a seed that depends on all numbers."""
    return int(SeedSequence(numbers).generate_state(1, "uint64")[0]) >> 1
