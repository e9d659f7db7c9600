"""Reader of checkpoints."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor

from .._weights import expect_tensors
from .blocks import ImageAdapter
from .config import Config
from .network import Network

__all__ = ["as_header", "load", "load_start", "read_header", "read_tensors"]

_POINTS = "condition_pc_adapter."
_HEADER = "pskel.models.pas"
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

    Raises ``ValueError``, which names the file, if it is no checkpoint, or if tensors are missing, additional or of
    another shape; ``OSError`` if it cannot be read.
    """
    return _assigned(config, read_tensors(path), path, dtype, device).eval()


def load_start(path: str | os.PathLike[str], config: Config = Config()) -> Network:
    """Read the weights that a training starts from, in ``float32``; returns the network in training mode.

    As ``load``, but the adapter of points may be missing. It is new then, with random weights from PyTorch's
    generator, and its zero convolutions are 0, so that it changes nothing yet.
    """
    tensors = read_tensors(path)
    if not any(name.startswith(_POINTS) for name in tensors):
        adapter = ImageAdapter(config.condition_pc_adapter_config)
        tensors |= {_POINTS + name: tensor for name, tensor in adapter.state_dict().items()}
    return _assigned(config, tensors, path, torch.float32, "cpu").train()


def as_header(values: Mapping[str, Any]) -> dict[str, str]:
    """Return what a training notes about its network as the header of a safetensors file."""
    # One text, since the format does not keep the order of several: the same training writes the same bytes.
    return {_HEADER: json.dumps(values, sort_keys=True)}


def read_header(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the values of ``as_header`` in a file; none for one of another kind or source."""
    if Path(path).suffix != ".safetensors":
        return {}
    try:
        with safe_open(path, "pt") as file:
            values = json.loads((file.metadata() or {}).get(_HEADER, "{}"))
    except (SafetensorError, ValueError) as error:
        raise ValueError(f"expected a file of safetensors, found {error}: {os.fspath(path)}") from error
    return values if isinstance(values, dict) else {}


def _assigned(
    config: Config,
    tensors: Mapping[str, Tensor],
    path: str | os.PathLike[str],
    dtype: torch.dtype,
    device: str | torch.device,
) -> Network:
    """A network with these tensors, converted one by one."""
    with torch.device("meta"):
        network = Network(config)
    expect_tensors(network.state_dict(), tensors, path)
    weights = {name: tensor.to(device, dtype) for name, tensor in tensors.items()}
    network.load_state_dict(weights, assign=True)
    return network


def read_tensors(path: str | os.PathLike[str]) -> dict[str, Tensor]:
    """Read the tensors of a checkpoint; raises ``ValueError``, which names the file, if it is none, and ``OSError``."""
    path = Path(path)
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
