"""Estimated memory and time of training: `python -m pskel.models.pas.cost --training` (docs/src/reference/pas.md)."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from diffusers.models.adapter import AdapterBlock
from torch import Tensor, nn

from ..._adamw8bit import AdamW8bit, state_bytes
from ..._cost import counted, recomputed_bytes, saved_bytes
from ..._rig import Published
from ..config import Config
from ..network import Network
from ..vae import LATENT_SCALE
from .modes import TrainMode, prepare
from .module import TrainedNetwork
from .step import Inputs

__all__ = ["RUNS", "Cost", "Run", "cost", "measured", "table"]

_TEXT_TOKENS, _LAYOUT_CHANNELS, _POINT_CHANNELS, _IDS = 154, 6, 20, 13
_BF16, _F32 = 2, 4
_MEASURED_STEPS = 3


class Run(NamedTuple):
    """Parts that are trained, and the optimizer."""

    train: str
    optimizer: str = "adamw"


RUNS = (
    Run("all"),
    Run("all", "adamw8bit"),
    Run("adapters"),
    Run("points"),
    Run("points+lora:16"),
)


@dataclass(frozen=True)
class Cost:
    """Counts for a training in bf16 with clips as of a published checkpoint, whose blocks are computed again."""

    run: Run
    trained: int
    """Parameters."""
    frozen: int
    state_bytes: int
    """Weights, gradients and moments; with ``adamw`` also the weights in bf16 that autocast keeps in a step."""
    input_bytes: int
    """Inputs of the network for a clip."""
    kept_bytes: int
    """Activations of a clip from the forward to the backward pass."""
    recomputed_bytes: int
    """Activations of the block that needs the most, while it is computed again."""
    operations: int
    """For a clip, forward and backward pass; an operation is a multiplication or an addition of a matrix product."""

    def total_bytes(self, clips: int = 1) -> int:
        """Peak for clips per process, without workspaces of kernels, autoencoder and text encoders."""
        return self.state_bytes + clips * (self.input_bytes + self.kept_bytes + self.recomputed_bytes)


def cost(run: Run, known: Published, config: Config = Config()) -> Cost:
    """Count on PyTorch's ``meta`` device, without memory or time for the numbers themselves."""
    mode = TrainMode.parse(run.train)
    with torch.device("meta"):
        module = TrainedNetwork(Network(config))
        inputs = _inputs(known, config)
    prepare(module.network, mode, trained_dtype=torch.bfloat16, frozen_dtype=torch.bfloat16)
    parameters = list(module.parameters())
    recomputed = recomputed_bytes(lambda: module(inputs), _recomputed(module))
    module.network.checkpoint_activations = True
    _, kept = saved_bytes(lambda: module(inputs), [*parameters, *module.buffers()])
    _, operations = counted(lambda: _backward(module, inputs))
    trained = [parameter for parameter in parameters if parameter.requires_grad]
    frozen = sum(parameter.numel() for parameter in parameters if not parameter.requires_grad)
    return Cost(
        run=run,
        trained=sum(parameter.numel() for parameter in trained),
        frozen=frozen,
        state_bytes=sum(_state_bytes(parameter.numel(), run) for parameter in trained) + _BF16 * frozen,
        input_bytes=sum(tensor.numel() * tensor.element_size() for tensor in vars(inputs).values()),
        kept_bytes=kept,
        recomputed_bytes=recomputed,
        operations=operations,
    )


def _state_bytes(count: int, run: Run) -> int:
    """Of a trained parameter of ``count`` numbers."""
    if run.optimizer == "adamw8bit":
        return count * (_BF16 + _BF16) + state_bytes(count, torch.bfloat16)
    return count * (_F32 + _F32 + 2 * _F32 + _BF16)


def _backward(module: nn.Module, inputs: Inputs) -> None:
    loss: Tensor = module(inputs).float().square().mean()
    torch.autograd.backward(loss)


def _recomputed(module: nn.Module) -> list[nn.Module]:
    """Modules that are computed again one by one."""
    names = TrainedNetwork._no_split_modules
    return [part for part in module.modules() if type(part).__name__ in names or isinstance(part, AdapterBlock)]


def _inputs(known: Published, config: Config) -> Inputs:
    """A clip of zeros, on the default device."""
    views, (height, width) = len(known.cameras), known.size
    leading = 1, known.frames, views
    return Inputs(
        sample=torch.zeros(*leading, config.in_channels, height // LATENT_SCALE, width // LATENT_SCALE),
        timestep=torch.zeros(leading),
        text=torch.zeros(*leading, _TEXT_TOKENS, config.joint_attention_dim, dtype=torch.bfloat16),
        pooled=torch.zeros(*leading, config.pooled_projection_dim, dtype=torch.bfloat16),
        layout=torch.zeros(*leading, _LAYOUT_CHANNELS, height, width),
        points=torch.zeros(*leading, _POINT_CHANNELS, height, width),
        ids=torch.zeros(*leading, _IDS),
        mask=torch.ones(1, views, views, dtype=torch.bool),
        single_frames=torch.zeros(1, dtype=torch.bool),
    )


def table(costs: Sequence[Cost], rate: float) -> Iterator[tuple[str, list[str]]]:
    """Return the rows for runs on one GPU of ``rate`` 10^12 operations per second."""
    yield "optimizer", [each.run.optimizer for each in costs]
    yield "parameters, trained and frozen", [f"{c.trained / 1e6:.0f} M, {c.frozen / 1e6:.0f} M" for c in costs]
    yield "weights, gradients, moments", [f"{c.state_bytes / 1e9:.1f} GB" for c in costs]
    yield "activations of a clip, kept; recomputed", [
        f"{(c.input_bytes + c.kept_bytes) / 1e9:.1f} GB; {c.recomputed_bytes / 1e9:.1f} GB" for c in costs
    ]
    yield "sum for 1 clip; 2 clips", ["; ".join(f"{c.total_bytes(n) / 1e9:.0f} GB" for n in (1, 2)) for c in costs]
    yield "operations per clip", [f"{c.operations / 1e12:.0f} T" for c in costs]
    yield f"time per clip at {rate:g} T/s", [f"{c.operations / rate / 1e12:.1f} s" for c in costs]


def measured(run: Run, known: Published, config: Config = Config()) -> tuple[float, int]:
    """Take steps of a clip with random weights on a GPU; returns seconds of the last one, and bytes of the peak."""
    torch.cuda.empty_cache()
    torch.cuda.reset_peak_memory_stats()
    is_8bit = run.optimizer == "adamw8bit"
    with torch.device("cuda"):
        module = TrainedNetwork(Network(config).bfloat16())
        trained_dtype = torch.bfloat16 if is_8bit else torch.float32
        mode = TrainMode.parse(run.train)
        prepare(module.network, mode, trained_dtype=trained_dtype, frozen_dtype=torch.bfloat16)
        inputs = _inputs(known, config)
    module.network.checkpoint_activations = True
    trained = [parameter for parameter in module.parameters() if parameter.requires_grad]
    optimizer: torch.optim.Optimizer = AdamW8bit(trained) if is_8bit else torch.optim.AdamW(trained)
    seconds = 0.0
    for _ in range(_MEASURED_STEPS):
        torch.cuda.synchronize()
        begin = time.perf_counter()
        with torch.autocast("cuda", torch.bfloat16):
            loss: Tensor = module(inputs).float().square().mean()
        torch.autograd.backward(loss)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        torch.cuda.synchronize()
        seconds = time.perf_counter() - begin
    return seconds, torch.cuda.max_memory_allocated()
