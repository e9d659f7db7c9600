"""Optimizers and the schedule of the learning rate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from ..models._adamw8bit import AdamW8bit
from .config import TrainOptions
from .errors import ConfigError
from .parallel import full, local

__all__ = [
    "clip_gradients",
    "create_optimizer",
    "load_moments",
    "moments",
    "named_groups",
    "rate",
    "set_rates",
]

_GROUP_KEYS = ("params", "lr", "betas", "eps", "weight_decay", "schedule")


def rate(options: TrainOptions, step: int) -> float:
    """Return the share of the learning rate in a step, numbered from 0: a linear rise, then the schedule."""
    if step < options.warmup:
        return (step + 1) / options.warmup
    if options.schedule == "constant":
        return 1.0
    part = (step - options.warmup) / max(1, options.steps - options.warmup)
    return options.final_rate + (1 - options.final_rate) * (1 + math.cos(math.pi * min(part, 1.0))) / 2


def named_groups(module: nn.Module, groups: Sequence[Mapping[str, Any]], player: str) -> list[dict[str, Any]]:
    """Return parameter groups with names in place of parameters: sharding replaces the parameters.

    Raises ``ConfigError`` for unknown keys, parameters of other modules, and trained parameters that are in no group.
    """
    names = {id(parameter): name for name, parameter in module.named_parameters()}
    found = []
    for group in groups:
        if unknown := [key for key in group if key not in _GROUP_KEYS]:
            raise ConfigError(
                f"expected the keys {', '.join(_GROUP_KEYS)} in a group of {player}, found {unknown[0]!r}"
            )
        parameters = list(group["params"])
        if any(id(parameter) not in names for parameter in parameters):
            raise ConfigError(f"expected parameters of the module of {player} in its groups, found others")
        found.append({**group, "params": [names[id(parameter)] for parameter in parameters]})
    grouped = [name for group in found for name in group["params"]]
    trained = {name for name, parameter in module.named_parameters() if parameter.requires_grad}
    if wrong := sorted(trained.symmetric_difference(grouped)):
        raise ConfigError(
            f"expected the trained parameters of {player} in its groups, found a difference in {wrong[0]}"
        )
    return found


def create_optimizer(
    module: nn.Module, groups: Sequence[Mapping[str, Any]], options: TrainOptions
) -> torch.optim.Optimizer:
    """Return AdamW over groups of ``named_groups``."""
    parameters = dict(module.named_parameters())
    filled = [
        {
            "betas": options.betas,
            "eps": options.epsilon,
            "weight_decay": options.weight_decay,
            **{key: value for key, value in group.items() if key != "schedule"},
            "lr": float(group.get("lr", options.learning_rate)),
            "params": [parameters[name] for name in group["params"]],
        }
        for group in groups
    ]
    kind: type[torch.optim.Optimizer] = torch.optim.AdamW if options.optimizer == "adamw" else AdamW8bit
    optimizer = kind(filled)  # type: ignore[call-arg]
    for group, given in zip(optimizer.param_groups, groups):
        group["base_lr"] = float(given.get("lr", options.learning_rate))
        group["is_constant"] = given.get("schedule") == "constant"
    return optimizer


def set_rates(optimizer: torch.optim.Optimizer, options: TrainOptions, step: int) -> float:
    """Set the learning rates of a step; returns the first group's."""
    for group in optimizer.param_groups:
        value = group["base_lr"] * (1.0 if group["is_constant"] else rate(options, step))
        if isinstance(group["lr"], Tensor):
            group["lr"].fill_(value)
        else:
            group["lr"] = value
    return float(optimizer.param_groups[0]["lr"])


def clip_gradients(module: nn.Module, most: float) -> float:
    """Limit the norm of a module's gradients, taken together, to ``most`` (0: no limit); returns the norm before."""
    parameters = [parameter for parameter in module.parameters() if parameter.grad is not None]
    if not parameters:
        return 0.0
    norm: Tensor = torch.nn.utils.clip_grad_norm_(parameters, most if most > 0 else math.inf)
    return float(full(norm))


def moments(optimizer: torch.optim.Optimizer) -> list[dict[str, Any]]:
    """Return the state of each parameter, in the order of the groups; of sharded ones this process's part."""
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    found = []
    for parameter in parameters:
        state = optimizer.state.get(parameter, {})
        found.append({key: local(value) if isinstance(value, Tensor) else value for key, value in state.items()})
    return found


def load_moments(optimizer: torch.optim.Optimizer, states: Sequence[Mapping[str, Any]], device: torch.device) -> None:
    """Restore ``moments``."""
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    for parameter, state in zip(parameters, states, strict=True):
        if state:
            optimizer.state[parameter] = {key: _placed(value, key, parameter, device) for key, value in state.items()}


def _placed(value: Any, key: str, parameter: Tensor, device: torch.device) -> Any:
    if not isinstance(value, Tensor):
        return value
    if key != "step":  # AdamW counts steps on the CPU
        value = value.to(device)
    # Moments of 8 bits are those of this process's part; moments in full have the form of the parameter.
    if hasattr(parameter, "to_local") and value.shape == local(parameter).shape:
        from torch.distributed.tensor import DTensor

        return DTensor.from_local(
            value,
            parameter.device_mesh,  # type: ignore[attr-defined]
            parameter.placements,  # type: ignore[attr-defined]
            shape=parameter.shape,
            stride=parameter.stride(),
        )
    return value
