"""Counts of operations and of memory for activations, also on PyTorch's ``meta`` device, which computes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention
from torch.overrides import TorchFunctionMode
from torch.utils.flop_counter import FlopCounterMode

__all__ = ["counted", "recomputed_bytes", "saved_bytes"]

_Result = TypeVar("_Result")


def counted(run: Callable[[], _Result]) -> tuple[_Result, int]:
    """Return the result of ``run`` and its operations: multiplications and additions of matrix products."""
    with FlopCounterMode(display=False) as counter:
        result = run()
    operations: int = counter.get_total_flops()
    return result, operations


def saved_bytes(run: Callable[[], _Result], parameters: Iterable[Tensor]) -> tuple[_Result, int]:
    """Return the result of ``run`` and the bytes of what autograd keeps for the backward pass, without ``parameters``.

    On the ``meta`` device, attention keeps what fused kernels keep: its inputs and output, not the weights of all
    pairs.
    """
    known = {_storage(parameter) for parameter in parameters}
    kept: dict[int, Tensor] = {}

    def pack(tensor: Tensor) -> Tensor:
        if _storage(tensor) not in known:
            kept.setdefault(_storage(tensor), tensor)  # the tensor, or another one may get its address
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor), _FusedAttention():
        result = run()
    return result, sum(tensor.untyped_storage().nbytes() for tensor in kept.values())


def recomputed_bytes(run: Callable[[], Any], modules: Iterable[nn.Module]) -> int:
    """Return the bytes of activations that the module computes again that needs the most of them.

    ``run`` calls the ``modules``, whose activations a checkpointed training computes one by one.
    """
    most = 0
    handles = []

    def measured(module: nn.Module, arguments: tuple[Any, ...], options: dict[str, Any], _: Any) -> None:
        nonlocal most
        inputs = [argument.detach().requires_grad_() if _is_real(argument) else argument for argument in arguments]
        named = {name: value.detach().requires_grad_() if _is_real(value) else value for name, value in options.items()}
        with torch.enable_grad():
            _, needed = saved_bytes(lambda: module.forward(*inputs, **named), module.parameters())
        most = max(most, needed)

    for module in modules:
        handles.append(module.register_forward_hook(measured, with_kwargs=True))
    try:
        with torch.no_grad():
            run()
    finally:
        for handle in handles:
            handle.remove()
    return most


class _FusedAttention(TorchFunctionMode):
    """Attention on the ``meta`` device as one operation."""

    def __torch_function__(
        self, function: Any, types: Any, arguments: tuple[Any, ...] = (), options: dict[str, Any] | None = None
    ) -> Any:
        if function is scaled_dot_product_attention and arguments[0].is_meta:
            return _Attention.apply(*arguments[:3])
        return function(*arguments, **(options or {}))


class _Attention(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
        out = query.new_empty((*query.shape[:-1], value.shape[-1]))
        context.save_for_backward(query, key, value, out)
        return out

    @staticmethod
    def backward(context: Any, *gradients: Tensor) -> tuple[Tensor, ...]:
        return tuple(torch.empty_like(tensor) for tensor in context.saved_tensors[:3])


def _is_real(value: Any) -> bool:
    return isinstance(value, Tensor) and value.is_floating_point()


def _storage(tensor: Tensor) -> int:
    address: int = tensor.untyped_storage()._cdata
    return address
