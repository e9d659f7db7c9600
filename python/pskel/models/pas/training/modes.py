"""Which parameters are trained: all, the adapters, the point adapter, or LoRA matrices of the blocks."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from ..._weights import add_lora, is_lora, lora_tensors, merge_lora, saved_name
from ..config import Config
from ..network import Network

__all__ = ["BLOCKS", "TrainMode", "full_weights", "lora_layers", "merged", "prepare", "trained_weights"]

BLOCKS = ("transformer_blocks", "crossview_transformer_blocks", "temporal_transformer_blocks")
_ADAPTERS = {"image": "condition_image_adapter.", "points": "condition_pc_adapter."}
_LORA_RANK = 16
_EXPECTED = "all, or adapters, points and lora:R joined by +"


class TrainMode(NamedTuple):
    """Parts of the network that are trained."""

    all: bool = False
    adapters: tuple[str, ...] = ()
    """``image`` (boxes and map), ``points``."""
    lora_rank: int = 0
    """Rank of the LoRA matrices (arXiv:2106.09685) of all linear layers in the blocks; 0 has none."""

    @classmethod
    def parse(cls, text: str) -> TrainMode:
        """Convert ``all``, or ``adapters``, ``points`` and ``lora:R`` joined by ``+``. Raises ``ValueError``."""
        mode = cls()
        for part in text.split("+"):
            kind, colon, rank = part.partition(":")
            if kind == "lora" and not mode.lora_rank and (not colon or (rank.isdecimal() and int(rank) > 0)):
                mode = mode._replace(lora_rank=int(rank or _LORA_RANK))
            elif part == "all" and part == text:
                mode = mode._replace(all=True)
            elif part in ("adapters", "points") and not mode.adapters:
                mode = mode._replace(adapters=tuple(_ADAPTERS) if part == "adapters" else ("points",))
            else:
                raise ValueError(f"expected train of {_EXPECTED}, found {text!r}")
        return mode

    def trains(self, name: str) -> bool:
        """Whether a parameter of the network is trained."""
        return self.all or is_lora(name) or name.startswith(tuple(_ADAPTERS[adapter] for adapter in self.adapters))


def prepare(
    network: Network,
    mode: TrainMode,
    *,
    with_points: bool = True,
    trained_dtype: torch.dtype = torch.float32,
    frozen_dtype: torch.dtype = torch.float32,
) -> None:
    """Add LoRA matrices, which change nothing yet, and let gradients reach the trained parameters alone.

    Without points, their adapter is not trained. Parameters are converted to ``trained_dtype`` or ``frozen_dtype``.
    Raises ``ValueError`` if nothing is trained, and for LoRA without peft.
    """
    if mode.lora_rank:
        add_lora(network, mode.lora_rank, _pattern(network))
    for name, parameter in network.named_parameters():
        is_used = with_points or not name.startswith(_ADAPTERS["points"])
        parameter.requires_grad_(is_used and mode.trains(name))
        parameter.data = parameter.data.to(trained_dtype if parameter.requires_grad else frozen_dtype)
    if not any(parameter.requires_grad for parameter in network.parameters()):
        raise ValueError("expected parameters to train, found none: the layout stage has no point adapter")


def lora_layers(network: nn.Module) -> list[str]:
    """Return the names of the linear layers in the blocks."""
    named = network.named_modules()
    return [name for name, module in named if isinstance(module, nn.Linear) and name.split(".")[0] in BLOCKS]


def merged(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the tensors of a checkpoint, LoRA matrices added, from the state of a network that may have them.

    Merged weights are ``float32``.
    """
    matrices = {saved_name(name): tensor for name, tensor in weights.items() if is_lora(name)}
    layers = {name.rpartition(".lora_")[0] for name in matrices}
    base = {saved_name(name): tensor for name, tensor in weights.items() if not is_lora(name)}
    for layer in layers:
        name = f"{layer}.weight"
        base[name] = base[name].detach().to(torch.float32, copy=True)
    merge_lora(base, matrices)
    return base


def trained_weights(weights: Mapping[str, Tensor], mode: TrainMode) -> dict[str, Tensor]:
    """Return the trained tensors alone, under the names of a file, from the state of a network."""
    return {saved_name(name): tensor for name, tensor in weights.items() if mode.trains(name)}


def full_weights(
    base: Mapping[str, Tensor], trained: Mapping[str, Tensor], config: Config, rank: int
) -> dict[str, Tensor]:
    """Put ``trained_weights`` into the tensors of a checkpoint, of which the point adapter may be missing.

    Raises ``ValueError`` for tensors that ``config`` does not have, with LoRA matrices of ``rank``.
    """
    with torch.device("meta"):
        network = Network(config)
    expected = network.state_dict()
    matrices = lora_tensors(network, rank, _pattern(network)) if rank else {}
    for name, tensor in trained.items():
        known = expected.get(name, matrices.get(name))
        if known is None or known.shape != tensor.shape:
            shape = "no such tensor" if known is None else list(known.shape)
            raise ValueError(f"expected trained tensors of the network, found {name} of {list(tensor.shape)}: {shape}")
    if missing := [name for name in matrices if name not in trained]:
        raise ValueError(f"expected LoRA matrices of rank {rank} for all linear layers, found no {missing[0]}")
    parts = {**base, **{name: tensor for name, tensor in trained.items() if name not in matrices}}
    return merged({**parts, **{name: tensor for name, tensor in trained.items() if name in matrices}})


def _pattern(network: nn.Module) -> str:
    return "|".join(map(re.escape, lora_layers(network)))
