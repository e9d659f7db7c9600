"""Checks of downloaded weights."""

from __future__ import annotations

import os
import pickle
from collections.abc import Mapping

import torch
from torch import Tensor


def read_weights(path: str | os.PathLike[str], expected: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Read `torch.save(state_dict)` with only tensors; raises ValueError for unexpected names or shapes."""
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError) as error:
        first = str(error).splitlines()[0]
        raise ValueError(f"{path}: expected weights of torch.save, found another file ({first})") from error
    if not isinstance(found, dict) or not all(isinstance(tensor, Tensor) for tensor in found.values()):
        raise ValueError(f"{path}: expected a dictionary of tensors, found {type(found).__name__}")
    missing = sorted(expected.keys() - found.keys())
    additional = sorted(found.keys() - expected.keys())
    shapes = [
        f"{name} of {list(found[name].shape)} instead of {list(tensor.shape)}"
        for name, tensor in expected.items()
        if name in found and found[name].shape != tensor.shape
    ]
    for what, names in (("missing", missing), ("additional", additional), ("misshapen", shapes)):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            raise ValueError(f"{path}: {len(names)} {what} tensors: {', '.join(names[:3])}{more}")
    return dict(found)
