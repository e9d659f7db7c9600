"""Tensors of checkpoints: comparison with a network, and LoRA matrices."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping

import torch
from torch import Tensor, nn

__all__ = ["add_lora", "expect_tensors", "is_lora", "lora_tensors", "merge_lora", "saved_name"]

_NAMED = 3
_LORA_A, _LORA_B = ".lora_A.weight", ".lora_B.weight"
_ADAPTER = "default"


def expect_tensors(expected: Mapping[str, Tensor], found: Mapping[str, Tensor], path: str | os.PathLike[str]) -> None:
    """Raise ``ValueError``, which names the file, unless both have the same names and shapes."""
    missing = [name for name in expected if name not in found]
    additional = [name for name in found if name not in expected]
    shapes = [
        f"{name}: expected {list(expected[name].shape)}, found {list(found[name].shape)}"
        for name in expected
        if name in found and expected[name].shape != found[name].shape
    ]
    problems = [("missing", missing), ("additional", additional), ("of another shape", shapes)]
    texts = [f"{len(names)} {kind} ({_listed(names)})" for kind, names in problems if names]
    if texts:
        raise ValueError(
            f"expected the {len(expected)} tensors of the network, found {', '.join(texts)}: {os.fspath(path)}"
        )


def add_lora(module: nn.Module, rank: int, pattern: str) -> None:
    """Add LoRA matrices (arXiv:2106.09685) to the linear layers whose whole name matches a regular expression.

    They change nothing before training. Raises ``ValueError`` without the package peft.
    """
    try:
        from peft import LoraConfig, inject_adapter_in_model
    except ImportError as error:
        raise ValueError("LoRA needs peft: pip install 'pskel[train]'") from error
    config = LoraConfig(r=rank, lora_alpha=rank, target_modules=pattern)
    inject_adapter_in_model(config, module, adapter_name=_ADAPTER)


def is_lora(name: str) -> bool:
    """Whether a parameter is a LoRA matrix."""
    return ".lora_A." in name or ".lora_B." in name


def saved_name(name: str) -> str:
    """Return a parameter's name in a file, for a network with LoRA matrices."""
    return name.replace(f".{_ADAPTER}.", ".") if is_lora(name) else name.replace(".base_layer.", ".")


def lora_tensors(module: nn.Module, rank: int, pattern: str, prefix: str = "") -> dict[str, Tensor]:
    """Return the LoRA matrices that a file has after ``add_lora``: names with ``prefix``, and empty tensors."""
    tensors = {}
    for name, layer in module.named_modules():
        if isinstance(layer, nn.Linear) and re.fullmatch(pattern, name):
            tensors[f"{prefix}{name}{_LORA_A}"] = torch.empty(rank, layer.in_features, device="meta")
            tensors[f"{prefix}{name}{_LORA_B}"] = torch.empty(layer.out_features, rank, device="meta")
    return tensors


def merge_lora(weights: Mapping[str, Tensor], matrices: Mapping[str, Tensor]) -> None:
    """Add the product of each pair of LoRA ``matrices``, which are named as in a file, to the weight of its layer, in place."""
    for name, first in matrices.items():
        if name.endswith(_LORA_A):
            layer = name.removesuffix(_LORA_A)
            weight = weights[layer + ".weight"]
            weight.data += (matrices[layer + _LORA_B].float() @ first.float()).to(weight)


def _listed(names: list[str]) -> str:
    return "; ".join([*names[:_NAMED], *([".."] if len(names) > _NAMED else [])])
