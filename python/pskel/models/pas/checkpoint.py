"""Reader of checkpoints."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from .._weights import expect_tensors
from .config import Config
from .network import Network

__all__ = ["load"]

_ZIP = b"PK\x03\x04"


def load(
    path: str | os.PathLike[str],
    config: Config = Config(),
    *,
    dtype: torch.dtype = torch.float32,
    device: str | torch.device = "cpu",
) -> Network:
    """Read the weights of a network from a file; returns it in evaluation mode.

    The file is in the format of safetensors if its name ends so, else of ``torch.save(state_dict)``; no code
    in it is run. Weights are converted to ``dtype`` one by one. ``config`` must match the training; the
    default matches the published checkpoints.

    Raises ``ValueError``, which names the file, if it is no checkpoint, or if tensors are missing, additional or of another
    shape; ``OSError`` if it cannot be read.
    """
    with torch.device("meta"):
        network = Network(config)
    tensors = _read(Path(path))
    expect_tensors(network.state_dict(), tensors, path)
    weights = {name: tensor.to(device, dtype) for name, tensor in tensors.items()}
    network.load_state_dict(weights, assign=True)
    return network.eval()


def _read(path: Path) -> dict[str, Tensor]:
    with path.open("rb") as file:
        beginning = file.read(16)
    if path.suffix == ".safetensors":
        try:
            return load_file(path)
        except SafetensorError as error:
            raise ValueError(f"expected a file of safetensors, found {error}: {path}") from error
    is_archive = beginning.startswith(_ZIP)  # since PyTorch 1.6
    try:
        values = torch.load(path, map_location="cpu", weights_only=True, mmap=is_archive)
    except (OSError, MemoryError):
        raise
    except Exception as error:  # of many kinds, by what the file is
        if not is_archive:
            found = f"a file that begins with {beginning!r}"
        elif isinstance(error, pickle.UnpicklingError):
            found = "objects of other types"
        else:
            found = "a damaged archive"
        raise ValueError(f"expected a checkpoint of tensors, found {found}: {path}") from error
    return _flat(values, path)


def _flat(values: Any, path: Path) -> dict[str, Tensor]:
    if not isinstance(values, dict):
        raise ValueError(f"expected a dictionary of tensors, found {type(values).__name__}: {path}")
    for name, value in values.items():
        if not isinstance(value, Tensor):
            raise ValueError(f"expected a dictionary of tensors, found {name!r} of {type(value).__name__}: {path}")
    return values
