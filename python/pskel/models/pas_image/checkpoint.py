"""Weights of the network: which are trained, what is saved, and their reader."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor

from .._weights import add_lora, expect_tensors, is_lora, lora_tensors, merge_lora, saved_name
from .base import expect_base, load_unet
from .config import Config
from .network import Network

__all__ = ["LORA_LAYERS", "Training", "create", "header", "is_trained", "load", "read_header", "saved_tensors"]

_FORMAT = "pskel-pas-image"
_VERSION = "1"
_ADDED = re.compile(r"\.(view|across_views|across_frames)\.")
"""Modules that are added to the UNet."""
LORA_LAYERS = r".*\.spatial\.transformer_blocks\.\d+\.(attn[12]\.(to_q|to_k|to_v|to_out\.0)|ff\.net\.(0\.proj|2))"
"""Linear layers of the UNet's transformers."""


class Training(NamedTuple):
    """Inputs that the network was trained with."""

    frames: int
    size: tuple[int, int]
    """Height and width."""
    fps: float


def create(config: Config, base: str | os.PathLike[str]) -> Network:
    """Create the network to train from a folder of Stable Diffusion 1.5; only its trained parameters require gradients.

    New weights are drawn from PyTorch's default generator. Raises ``ValueError``, which names the folder or file.
    """
    network = Network(config, load_unet(expect_base(base, with_unet=True), config))
    if config.trained == "lora":
        add_lora(network.unet, config.lora_rank, LORA_LAYERS)
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(is_trained(name, config))
    return network


def is_trained(name: str, config: Config) -> bool:
    """Whether a parameter of the network is trained, by its name there or in a file."""
    return config.trained == "all" or is_lora(name) or not name.startswith("unet.") or _ADDED.search(name) is not None


def saved_tensors(tensors: Mapping[str, Tensor], config: Config) -> dict[str, Tensor]:
    """Return the trained tensors of a network's state, by their names in a file."""
    return {saved_name(name): tensor for name, tensor in tensors.items() if is_trained(name, config)}


def header(config: Config, training: Training) -> dict[str, str]:
    """Return the texts of a file's header."""
    return {
        "format": _FORMAT,
        "version": _VERSION,
        "config": config.to_json(),
        "training": json.dumps(training._asdict()),
    }


def read_header(path: str | os.PathLike[str]) -> tuple[Config, Training]:
    """Read configuration and inputs of the training from a file.

    Raises ``ValueError``, which names the file, if it is no file of this network; ``OSError`` if it cannot be read.
    """
    source = os.fspath(path)
    with Path(path).open("rb"):  # errors of the system in their own words
        pass
    try:
        with safe_open(source, framework="pt") as file:
            texts: dict[str, str] = file.metadata() or {}
    except SafetensorError as error:
        raise ValueError(f"expected a file of safetensors, found {error}: {source}") from error
    found = texts.get("format"), texts.get("version")
    if found != (_FORMAT, _VERSION):
        raise ValueError(
            f"expected weights of {_FORMAT}, version {_VERSION}, found {found[0]}, version {found[1]}: {source}"
        )
    try:
        return Config.parse(json.loads(texts["config"]), source), _training(json.loads(texts["training"]))
    except (KeyError, TypeError, json.JSONDecodeError) as error:
        raise ValueError(f"expected config and training in the header, found {error!r}: {source}") from error


def load(
    path: str | os.PathLike[str],
    base: str | os.PathLike[str] | None = None,
    *,
    dtype: torch.dtype = torch.float32,
    device: str | torch.device = "cpu",
) -> Network:
    """Read the weights of a network from a file of a training; returns it in evaluation mode.

    ``base``, a folder of Stable Diffusion 1.5, has the weights that were not trained. LoRA matrices become part of the
    layers. Raises ``ValueError``, which names the file or folder, if tensors are missing, additional or of another
    shape, and without ``base`` if it is needed; ``OSError`` if a file cannot be read.
    """
    config, _ = read_header(path)
    tensors = load_file(path)
    unet = None
    if config.trained != "all":
        if base is None:
            raise ValueError(
                f"expected the folder of Stable Diffusion 1.5 for weights of {config.trained}, found none: {path}"
            )
        unet = load_unet(expect_base(base, with_unet=True), config)
    with torch.device("meta"):
        network = Network(config, unet)
    expected = saved_tensors(network.state_dict(), config)
    lora = lora_tensors(network.unet, config.lora_rank, LORA_LAYERS, "unet.") if config.trained == "lora" else {}
    expect_tensors({**expected, **lora}, tensors, path)
    network.load_state_dict({name: tensors[name] for name in expected}, strict=False, assign=True)
    merge_lora(network.state_dict(), {name: tensors[name] for name in lora})
    return network.to(device, dtype).eval()


def _training(values: Any) -> Training:
    height, width = values["size"]
    return Training(int(values["frames"]), (int(height), int(width)), float(values["fps"]))
