"""Files of weights, as the program reads them: safetensors with configuration and statistics in the header."""

from __future__ import annotations

import json
from os import PathLike

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from .config import SmallConfig
from .network import SmallNetwork

HEADER = "network"
STATISTICS = ("means", "scales", "priors")


def header(network: SmallNetwork) -> dict[str, str]:
    """Return the metadata of a file."""
    statistics = {name: getattr(network, name).tolist() for name in STATISTICS}
    return {HEADER: json.dumps({"config": network.config.to_json(), "statistics": statistics})}


def parameters(network: SmallNetwork) -> dict[str, Tensor]:
    """Return the parameters by name, ``float32`` on the CPU."""
    return {name: each.detach().float().cpu().contiguous().clone() for name, each in network.named_parameters()}


def save(network: SmallNetwork, path: str | PathLike[str]) -> None:
    """Write a file of weights."""
    save_file(parameters(network), path, header(network))


def load(path: str | PathLike[str]) -> SmallNetwork:
    """Read a file of weights. Raises ``ValueError`` that names the file if it is another one."""
    with safe_open(path, "pt") as file:
        text = (file.metadata() or {}).get(HEADER)
        if text is None:
            raise ValueError(f"expected weights of pskel.models.small, found no {HEADER} in the header: {path}")
        values = json.loads(text)
        network = SmallNetwork(SmallConfig.from_json(values["config"]))
        found = {name: file.get_tensor(name) for name in file.keys()}
    expected = dict(network.named_parameters())
    if different := sorted(set(expected) ^ set(found)):
        raise ValueError(f"expected {len(expected)} parameters, found {len(found)}, first difference {different[0]}: {path}")
    for name, tensor in found.items():
        if tensor.shape != expected[name].shape:
            raise ValueError(f"expected {name} of {list(expected[name].shape)}, found {list(tensor.shape)}: {path}")
    with torch.no_grad():
        for name, tensor in found.items():
            expected[name].copy_(tensor)
        for name in STATISTICS:
            getattr(network, name).copy_(torch.tensor(values["statistics"][name]))
    return network
