"""Estimates for training: `python -m pskel.models.pas_image.cost --training` (docs/src/reference/pas.md)."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import torch
from diffusers.models.attention import BasicTransformerBlock
from diffusers.models.resnet import ResnetBlock2D
from torch import Tensor, nn

from .._cost import counted, recomputed_bytes, saved_bytes
from .._weights import add_lora
from .blocks import Adapter
from .checkpoint import LORA_LAYERS, is_trained
from .config import LATENT_SCALE, TEXT_TOKENS, Config, Trained
from .network import IDS, LAYOUT_CHANNELS, POINT_CHANNELS, Inputs, Network

__all__ = ["COLUMNS", "MODES", "TITLE", "Cost", "cost", "measured", "measured_rows", "rows"]

MODES: tuple[tuple[Trained, int], ...] = (("all", 0), ("adapters", 0), ("lora", 16))
"""Trained weights, and rank of LoRA matrices."""
_SIZE, _VIEWS = (224, 400), 6
TITLE = f"{_SIZE[0]}x{_SIZE[1]}, 2 frames, {_VIEWS} cameras"
COLUMNS = tuple(f"{trained}, rank {rank}" if rank else trained for trained, rank in MODES)
"""Heads of the table."""
_FROZEN_MODELS = 83_653_863 + 123_060_480
"""Parameters of Stable Diffusion 1.5's autoencoder and text encoder, in single precision."""
_STATE, _STATE_8BIT, _FROZEN = 18, 12, 6
"""Bytes of a trained weight: itself, gradient and two moments in f32 (or moments of 8 bits), copy in bf16. Of a frozen
one."""
_KEY_FRAMES, _EPOCHS = 28_000, 200
"""Of the paper's training on nuScenes."""
_MEASURED_STEPS = 3


@dataclass(frozen=True)
class Cost:
    """Counts for one clip of two frames and six cameras of 224x400 pixels, in bf16."""

    trained: int
    """Parameters."""
    frozen: int
    activation_bytes: int
    checkpointed_bytes: int
    """Activations if blocks are computed again in the backward pass."""
    step_operations: int
    """Of forward and backward pass; an operation is a multiplication or an addition of a matrix product."""
    call_operations: int
    """Of the forward pass."""

    @property
    def state_bytes(self) -> int:
        """Weights, gradients and moments."""
        return _STATE * self.trained + _FROZEN * self.frozen + 4 * _FROZEN_MODELS

    @property
    def state_bytes_8bit(self) -> int:
        """The same with moments of 8 bits."""
        return self.state_bytes - (_STATE - _STATE_8BIT) * self.trained


@lru_cache
def cost(trained: Trained, rank: int, config: Config = Config()) -> Cost:
    """Count parameters, activations and operations on PyTorch's ``meta`` device, without memory for them."""
    config = replace(config, trained=trained, lora_rank=rank)
    with torch.device("meta"):
        network, inputs = _network(config).to(torch.bfloat16), _inputs(config)
        parameters = list(network.parameters())
        with torch.no_grad():
            _, call_operations = counted(lambda: network(inputs))
        _, activations = saved_bytes(lambda: network(inputs), parameters)
        _, step_operations = counted(lambda: network(inputs).sum().backward())
        recomputed = recomputed_bytes(lambda: network(inputs), _recomputed(network))
        network.enable_checkpointing()
        _, kept = saved_bytes(lambda: network(inputs), parameters)
    count = sum(parameter.numel() for parameter in parameters if parameter.requires_grad)
    return Cost(
        trained=count,
        frozen=sum(parameter.numel() for parameter in parameters) - count,
        activation_bytes=activations,
        checkpointed_bytes=kept + recomputed,
        step_operations=step_operations,
        call_operations=call_operations,
    )


def rows(costs: Sequence[Cost], rate: float) -> Iterator[tuple[str, list[str]]]:
    """Return the rows of the table at ``rate`` times 10^12 operations per second."""
    seconds = [each.step_operations / (rate * 1e12) for each in costs]
    yield "parameters, trained and frozen", [f"{c.trained / 1e6:.0f} M, {c.frozen / 1e6:.0f} M" for c in costs]
    yield "weights, gradients, moments", [f"{c.state_bytes / 1e9:.1f} GB" for c in costs]
    yield "with moments of 8 bits", [f"{c.state_bytes_8bit / 1e9:.1f} GB" for c in costs]
    yield "activations per clip", [f"{c.activation_bytes / 1e9:.1f} GB" for c in costs]
    yield "with `checkpointing`", [f"{c.checkpointed_bytes / 1e9:.1f} GB" for c in costs]
    yield (
        "sum for 1 clip; 4 clips",
        ["; ".join(f"{(c.state_bytes + clips * c.activation_bytes) / 1e9:.0f} GB" for clips in (1, 4)) for c in costs],
    )
    yield (
        "operations per clip; with `checkpointing`",
        [f"{c.step_operations / 1e12:.1f} T; {(c.step_operations + c.call_operations) / 1e12:.1f} T" for c in costs],
    )
    yield f"time per clip at {rate:g} T/s", [f"{each:.3f} s" for each in seconds]
    yield (
        f"the paper's {_EPOCHS} epochs on nuScenes",
        [f"{_EPOCHS * _KEY_FRAMES * each / 86400:.1f} days" for each in seconds],
    )


def measured_rows(config: Config) -> Iterator[tuple[str, list[str]]]:
    """Take steps on a GPU; returns more rows of the table."""
    device = torch.device("cuda")
    found = [measured(replace(config, trained=trained, lora_rank=rank), device) for trained, rank in MODES]
    name = torch.cuda.get_device_name()
    yield f"measured on {name}: time per step of 1 clip", [f"{seconds:.3f} s" for seconds, _ in found]
    yield "peak memory, without autoencoder and text encoder", [f"{peak / 1e9:.1f} GB" for _, peak in found]


def measured(config: Config, device: torch.device) -> tuple[float, int]:
    """Take steps with random weights; returns seconds of the last one, and on a GPU the bytes of the peak, else 0."""
    is_gpu = device.type == "cuda"
    if is_gpu:
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    with device:
        network, inputs = _network(config), _inputs(config)
    optimizer = torch.optim.AdamW(parameter for parameter in network.parameters() if parameter.requires_grad)
    seconds = 0.0
    for _ in range(_MEASURED_STEPS):
        begin = time.perf_counter()
        with torch.autocast(device.type, torch.bfloat16):
            loss: Tensor = network(inputs).float().square().mean()
        torch.autograd.backward(loss)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        if is_gpu:
            torch.cuda.synchronize()
        seconds = time.perf_counter() - begin
    return seconds, torch.cuda.max_memory_allocated() if is_gpu else 0


def _network(config: Config) -> Network:
    network = Network(config)
    if config.trained == "lora":
        add_lora(network.unet, config.lora_rank, LORA_LAYERS)
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(is_trained(name, config))
    return network


def _inputs(config: Config) -> Inputs:
    """One clip, on the default device."""
    (height, width), leading = _SIZE, (1, 2, _VIEWS)
    return Inputs(
        sample=torch.zeros(*leading, config.in_channels, height // LATENT_SCALE, width // LATENT_SCALE),
        timestep=torch.zeros(1, 2),
        text=torch.zeros(*leading, TEXT_TOKENS, config.cross_attention_dim),
        layout=torch.zeros(*leading, LAYOUT_CHANNELS, height, width),
        points=torch.zeros(*leading, POINT_CHANNELS, height, width),
        ids=torch.zeros(*leading, IDS),
        mask=torch.ones(1, _VIEWS, _VIEWS, dtype=torch.bool),
        single_frames=torch.zeros(1, dtype=torch.bool),
    )


def _recomputed(network: Network) -> list[nn.Module]:
    """Modules that are computed again one by one."""
    kinds: tuple[Any, ...] = (ResnetBlock2D, BasicTransformerBlock, Adapter)
    return [module for module in network.modules() if isinstance(module, kinds)]

