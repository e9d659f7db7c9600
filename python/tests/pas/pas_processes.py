"""Steps of the task in processes of their own, as the harness takes them."""

import os
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from pas_clips import clip
from pskel.models._adamw8bit import AdamW8bit
from pskel.models.pas.task import PasTask, task
from pskel.train.config import TrainOptions
from pskel.train.parallel import Processes, full, shard_module
from torch.distributed.fsdp import FSDPModule

STEPS = 2
CPU = torch.device("cpu")


class Step(torch.nn.Module):
    """The loss as a module, so that DDP sees the parameters."""

    def __init__(self, of: PasTask) -> None:
        super().__init__()
        self.module = of.network
        self._of = of

    def forward(self, drawn: Any) -> Any:
        return self._of.loss("network", drawn, {"network": self.module}, CPU)[0]


def create(options: dict[str, Any]) -> PasTask:
    torch.manual_seed(0)
    return task(options, TrainOptions())


def steps(step: Any, of: PasTask, optimizer: Any, clips: list[Any], rank: int, count: int = STEPS) -> list[float]:
    losses = []
    for number in range(count):
        loss = step(of.draw(clips, number, 0, rank))
        torch.autograd.backward(loss)
        optimizer.step()
        optimizer.zero_grad()
        losses.append(float(loss.detach()))
    return losses


def run(rank: int, options: dict[str, Any], folder: str) -> None:
    """One of two processes, each with a clip: DDP, then FSDP, then FSDP with moments of 8 bits."""
    torch.set_num_threads(1)
    store = dist.FileStore(os.path.join(folder, "store"), 2)  # type: ignore[attr-defined]
    dist.init_process_group("gloo", store=store, rank=rank, world_size=2)
    found: dict[str, Any] = {}
    for kind in ("ddp", "fsdp", "fsdp8"):
        of = create(options)
        if kind == "ddp":
            step: torch.nn.Module = torch.nn.parallel.DistributedDataParallel(Step(of), broadcast_buffers=False)
        else:
            shard_module(of.network, Processes(rank, 2, CPU))
            units = [part for part in of.network.modules() if isinstance(part, FSDPModule)]
            found["units"] = sorted(type(part).__name__ for part in units)
            step = Step(of)
        kinds: Any = AdamW8bit if kind == "fsdp8" else torch.optim.AdamW
        count = 1 if kind == "fsdp8" else STEPS
        losses = steps(step, of, kinds(of.players[0].groups, lr=1e-3), [clip(rank)], rank, count)
        tensors, _ = of.weights({"network": of.network})
        found[kind] = losses, {name: full(tensor).detach().clone() for name, tensor in tensors.items()}
    torch.save(found, Path(folder) / f"rank{rank}.pt")
    dist.destroy_process_group()
