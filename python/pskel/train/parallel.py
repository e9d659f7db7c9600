"""The processes of a training: one per GPU, started by ``accelerate launch`` or ``torchrun``, or a single one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import timedelta
from inspect import signature
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor, nn

from .errors import TrainError, first_line

__all__ = [
    "LostError",
    "Processes",
    "end_processes",
    "full",
    "is_lost",
    "local",
    "lost_processes",
    "reshard",
    "shard_module",
    "start_processes",
    "without_sync",
    "wrap_step",
]

_TIMEOUT = timedelta(minutes=30)
_Value = TypeVar("_Value")
_LOST = (
    "Connection closed",
    "Connection reset",
    "Broken pipe",
    "Timed out",
    "NCCL",
    "Socket",
    "connectFullMesh",
    "heartbeat",
)
"""Texts of errors that say that another process is gone."""


@dataclass(frozen=True)
class Processes:
    """The processes, as one of them sees them."""

    rank: int = 0
    count: int = 1
    device: torch.device = torch.device("cpu")

    @property
    def is_main(self) -> bool:
        """Whether this process writes files and messages."""
        return self.rank == 0

    def gather(self, value: _Value) -> list[_Value]:
        """Return the values of all processes, by rank."""
        if self.count == 1:
            return [value]
        values: list[Any] = [None] * self.count
        with lost_processes():
            dist.all_gather_object(values, value)
        return values

    @contextmanager
    def agreed(self) -> Iterator[None]:
        """Raise the error of one process in all of them. The body must not communicate."""
        failure: TrainError | None = None
        try:
            yield
        except TrainError as error:
            failure = error
        failures = [error for error in self.gather(failure) if error is not None]
        if failures:
            failures[0].of_all = True
            raise failures[0]

    def share(self, tensors: Iterable[Tensor]) -> None:
        """Overwrite tensors with the main process's."""
        if self.count > 1:
            with lost_processes():
                for tensor in tensors:
                    # A backend may know the device of the process alone.
                    there = tensor.detach().to(self.device).contiguous()
                    dist.broadcast(there, 0)
                    tensor.detach().copy_(there)

    def share_object(self, value: _Value) -> _Value:
        """Return the value of the main process."""
        if self.count == 1:
            return value
        values = [value]
        with lost_processes():
            dist.broadcast_object_list(values, 0)
        return values[0]


@contextmanager
def lost_processes() -> Iterator[None]:
    """Turn errors of communication into one line."""
    try:
        yield
    except RuntimeError as error:
        if not is_lost(error):
            raise
        raise LostError.create(dist.get_rank()) from error


class LostError(TrainError):
    """Another process is gone."""

    @classmethod
    def create(cls, rank: int) -> LostError:
        """Return the error of a process that remains."""
        return cls(f"another process of the training ended, see its message; process {rank} ends too")


def is_lost(error: BaseException) -> bool:
    """Return whether an error of several processes says that another one is gone."""
    if not dist.is_available() or not dist.is_initialized():
        return False
    return isinstance(error, dist.DistError) or any(text in str(error) for text in _LOST)


def start_processes() -> Processes:
    """Join the processes that ``accelerate launch`` or ``torchrun`` has started, if any, and choose the device.

    Raises ``TrainError`` if they do not find each other.
    """
    try:
        from accelerate import PartialState
    except ImportError:
        raise TrainError("training needs accelerate: pip install 'pskel[train]'") from None
    try:
        state = PartialState(cpu=not torch.cuda.is_available(), timeout=_TIMEOUT)
    except (RuntimeError, ValueError) as error:
        raise TrainError(f"the processes of the training do not find each other: {first_line(error)}") from error
    if state.num_processes == 1:
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        return Processes(device=device)
    device = torch.device("cpu") if state.device.type == "cpu" else state.device
    return Processes(state.process_index, state.num_processes, device)


def end_processes() -> None:
    """Leave the group of processes, if there is one, after the last training of this process."""
    if dist.is_initialized():
        dist.destroy_process_group()


def shard_module(module: nn.Module, processes: Processes) -> None:
    """Divide the parameters of a module among the processes (FSDP), in place; they become ``DTensor``.

    The units that are gathered at a time are the submodules whose classes ``module._no_split_modules`` names, as in
    diffusers and transformers, and the rest of the module.
    """
    from torch.distributed.device_mesh import init_device_mesh
    from torch.distributed.fsdp import fully_shard

    if not dist.is_initialized():
        backend = "nccl" if processes.device.type == "cuda" else "gloo"
        dist.init_process_group(backend, store=dist.HashStore(), rank=0, world_size=1)  # type: ignore[attr-defined]
    mesh = init_device_mesh(processes.device.type, (processes.count,))
    names = getattr(module, "_no_split_modules", None) or ()
    for part in module.modules():
        if part is not module and type(part).__name__ in names:
            fully_shard(part, mesh=mesh)
    fully_shard(module, mesh=mesh)


def reshard(module: nn.Module) -> None:
    """Drop gathered parameters of a sharded module, which an evaluation leaves and the next step would use."""
    for part in module.modules():
        if hasattr(part, "set_requires_gradient_sync"):
            part.reshard()  # type: ignore[operator]


def wrap_step(step: nn.Module, processes: Processes, *, sharded: bool, unused: bool) -> nn.Module:
    """Return a module whose gradients are the means over all processes (DDP), unless they are anyway.

    With ``unused``, a step may leave parameters without a gradient.
    """
    if processes.count == 1 or sharded:
        return step
    ddp: Any = nn.parallel.DistributedDataParallel
    # Buffers are the same in all processes, or statistics of each. PyTorch has renamed the option.
    names = signature(ddp).parameters
    buffers = "forward_sync_buffers" if "forward_sync_buffers" in names else "broadcast_buffers"
    with lost_processes():
        wrapped: nn.Module = ddp(step, **{buffers: False}, find_unused_parameters=unused)
        return wrapped


class _Unsynchronized:
    """Sharded modules whose gradients remain in each process."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def __enter__(self) -> None:
        self._module.set_requires_gradient_sync(False)

    def __exit__(self, *_error: object) -> None:
        self._module.set_requires_gradient_sync(True)


def without_sync(step: nn.Module, module: nn.Module) -> AbstractContextManager[Any]:
    """Return a context in which gradients are added in each process and not averaged, for all batches of a step but the
    last."""
    if isinstance(step, nn.parallel.DistributedDataParallel):
        context: AbstractContextManager[Any] = step.no_sync()
        return context
    return _Unsynchronized(module) if hasattr(module, "set_requires_gradient_sync") else nullcontext()


def local(tensor: Tensor) -> Tensor:
    """Return this process's part of a sharded tensor, else the tensor. It shares its memory."""
    return tensor.to_local() if hasattr(tensor, "to_local") else tensor


def full(tensor: Tensor) -> Tensor:
    """Return the whole of a sharded tensor, which all processes have to ask for, else the tensor."""
    return tensor.full_tensor() if hasattr(tensor, "full_tensor") else tensor
