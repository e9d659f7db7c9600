"""AdamW with moments of 8 bits, and weights in single precision for parameters in half precision.

*8-bit Optimizers via Block-wise Quantization* (arXiv:2110.02861): blocks of 256 numbers share a scale, and the levels
follow the paper's dynamic map. Rounding to the nearest level would stop second moments: with beta 0.999 a step
changes them by less than the distance of two levels. Here a number takes one of its two neighbors, so that the mean
is right. Which one depends on step and place alone: a training repeats bit by bit.

torchao's optimizer, the alternative, rounds to the nearest level, compiles its step on first use, and saves tensors
in its own class, which a process that has not imported torchao cannot read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

__all__ = ["BLOCK", "AdamW8bit", "state_bytes"]

BLOCK = 256
"""Numbers that share a scale."""
_SMALL = 4096
"""Smaller tensors keep moments in ``float32``; they are few, and often norms and biases."""
_DECADES = 7
_WORD, _FACTOR, _SPREAD = 0xFFFFFFFF, 0x45D9F3B, 2654435769
"""Of the hash of 32 bits that rounds."""


class AdamW8bit(torch.optim.Optimizer):
    """AdamW (arXiv:1711.05101) with 2 bytes of moments per parameter, and 4 more for one in half precision.

    Computes what ``torch.optim.AdamW`` does, up to the rounding of the moments. Parameters in half precision are the
    rounded values of weights in ``float32``, which the state has. Sharded parameters (``DTensor``) are stepped in
    parts; blocks do not cross them.
    """

    def __init__(
        self,
        params: Iterable[Any],
        lr: float = 1e-3,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
        weight_decay: float = 1e-2,
    ) -> None:
        super().__init__(params, {"lr": lr, "betas": betas, "eps": eps, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """Update the parameters that have gradients."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    self._update(parameter, group)
        return loss

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore a ``state_dict``. Unlike PyTorch's, it does not convert moments to the type of the parameters."""
        super().load_state_dict({**state_dict, "state": {}})
        parameters = [parameter for group in self.param_groups for parameter in group["params"]]
        for number, values in state_dict["state"].items():
            device = parameters[number].device
            self.state[parameters[number]] = {
                key: value.to(device, copy=True) if isinstance(value, Tensor) else value
                for key, value in values.items()
            }

    def _update(self, parameter: Tensor, group: dict[str, Any]) -> None:
        weights, gradient = _local(parameter.data), _local(parameter.grad).float()  # type: ignore[arg-type]
        if not weights.numel():
            return  # the part of another process
        state = self.state[parameter]
        if not state:
            state.update(_initial(weights))
        state["step"] += 1
        master = weights if weights.dtype is torch.float32 else _local(state["master"])
        beta1, beta2 = group["betas"]
        first = _read(state, "first").view_as(master).lerp_(gradient, 1.0 - beta1)
        second = _read(state, "second").view_as(master).mul_(beta2).addcmul_(gradient, gradient, value=1.0 - beta2)
        _write(state, "first", first)
        _write(state, "second", second)
        rate = float(group["lr"])
        correction1, correction2 = 1.0 - beta1 ** state["step"], 1.0 - beta2 ** state["step"]
        denominator = second.sqrt_().div_(correction2**0.5).add_(group["eps"])
        master.mul_(1.0 - rate * group["weight_decay"])
        master.addcdiv_(first, denominator, value=-rate / correction1)
        if master is not weights:
            weights.copy_(master)


def state_bytes(count: int, dtype: torch.dtype) -> int:
    """Return the bytes of state for a parameter of ``count`` numbers."""
    master = 0 if dtype is torch.float32 else 4 * count
    if count < _SMALL:
        return master + 8 * count
    return master + 2 * (count + 4 * _blocks(count))


def _initial(weights: Tensor) -> dict[str, Any]:
    """The state before the first step."""
    state: dict[str, Any] = {"step": 0}
    if weights.dtype is not torch.float32:
        state["master"] = weights.float()
    count = weights.numel()
    for name in ("first", "second"):
        if count < _SMALL:
            state[name] = torch.zeros(count, device=weights.device)
        else:
            state[name] = torch.zeros(count, dtype=torch.uint8, device=weights.device)
            state[f"{name}_scale"] = torch.zeros(_blocks(count), device=weights.device)  # so all numbers are 0
    return state


def _read(state: dict[str, Any], name: str) -> Tensor:
    """Return a moment in ``float32 [N]``, a copy."""
    codes = _local(state[name])
    if codes.dtype is not torch.uint8:
        return codes.clone()
    values = _levels(codes.device, signed=name == "first")[codes.int()]
    return _scaled(values, _local(state[f"{name}_scale"]))


def _write(state: dict[str, Any], name: str, values: Tensor) -> None:
    """Store a moment ``float32``."""
    codes = _local(state[name])
    values = values.flatten()
    if codes.dtype is not torch.uint8:
        codes.copy_(values)
        return
    signed = name == "first"
    scale = _maxima(values)
    _local(state[f"{name}_scale"]).copy_(scale)
    relative = _scaled(values, torch.where(scale > 0, 1.0 / scale, 0.0))
    levels = _levels(codes.device, signed=signed)
    lower = torch.bucketize(relative, levels, right=True, out_int32=True).sub_(1).clamp_(0, len(levels) - 2)
    low, high = levels[lower], levels[lower + 1]
    is_upper = _dither(len(relative), state["step"], codes.device, signed=signed) < (relative - low) / (high - low)
    if not signed:
        # A second moment of 0 would divide by nearly 0.
        is_upper |= (relative > 0) & (lower == 0)
    codes.copy_(lower + is_upper)


@lru_cache(maxsize=8)
def _levels(device: torch.device, *, signed: bool) -> Tensor:
    """The 256 levels, increasing up to 1: 0, and in each decade below 1 twice as many as in the next lower one."""
    parts = [torch.tensor([0.0, 1.0], dtype=torch.float64)]
    for decade in range(_DECADES):
        bounds = torch.linspace(0.1, 1.0, 2**decade * (1 if signed else 2) + 1, dtype=torch.float64)
        centers = (bounds[:-1] + bounds[1:]) / 2 * 10.0 ** (decade + 1 - _DECADES)
        parts += [centers, -centers] if signed else [centers]
    return torch.cat(parts).sort().values.to(device, torch.float32)


def _dither(count: int, step: int, device: torch.device, *, signed: bool) -> Tensor:
    """Random numbers from 0 to below 1, ``float32 [count]``: a hash of place, step and moment, the same on all devices.

    A low-discrepancy sequence in its place left second moments 3 % too small: each place has to be independent from
    step to step.
    """
    numbers = torch.arange(count, device=device, dtype=torch.int64)
    numbers ^= (2 * step + signed) * _SPREAD & _WORD
    for _ in range(2):
        numbers = (numbers ^ (numbers >> 16)) * _FACTOR & _WORD
    return ((numbers ^ (numbers >> 16)) >> 8).float() * 2.0**-24


def _blocks(count: int) -> int:
    return -(-count // BLOCK)


def _maxima(values: Tensor) -> Tensor:
    """Largest magnitude of each block."""
    whole = len(values) // BLOCK * BLOCK
    parts = [values[:whole].view(-1, BLOCK).abs().amax(1)]
    if whole < len(values):
        parts.append(values[whole:].abs().amax().view(1))
    return torch.cat(parts)


def _scaled(values: Tensor, scale: Tensor) -> Tensor:
    """Multiply each block by its scale."""
    whole = len(values) // BLOCK * BLOCK
    out = torch.empty_like(values)
    torch.mul(values[:whole].view(-1, BLOCK), scale[: whole // BLOCK, None], out=out[:whole].view(-1, BLOCK))
    if whole < len(values):
        torch.mul(values[whole:], scale[-1], out=out[whole:])
    return out


def _local(tensor: Tensor) -> Tensor:
    """Return this process's part of a sharded tensor, else the tensor; it shares its memory."""
    part: Tensor = tensor.to_local() if hasattr(tensor, "to_local") else tensor
    return part
