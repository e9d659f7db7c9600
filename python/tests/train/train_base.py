"""Recorded clips of random numbers, a task of a linear model on them, and runs of the command."""

from __future__ import annotations

import csv
import io
import json
import os
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from pskel.train import Clip, Player, TrainOptions
from torch import Tensor, nn

SIZE = (8, 12)
VIEWS = 2
RECIPE: dict[str, Any] = {
    "drawn": "16x24",
    "size": "8x12",
    "splat": "15:1,100:0",
    "radius_m": 100.0,
    "color_filter": "bilinear",
    "bins": {"scale": "linear", "count": 256, "far_m": 100.0, "gamma": 1.0},
    "min_actor_points": 20000,
    "template_fit": "box",
    "line_width": "fixed",
    "map_layers": "lanes",
}
"""As the program that recorded clips until now writes it."""


def arrays_of(frames: int, seed: int = 0) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays of a recorded clip."""
    random = np.random.default_rng(seed)
    rgb = (frames, VIEWS, *SIZE, 3)
    color = random.integers(0, 256, rgb, np.uint8)
    arrays = {
        "action": random.normal(size=(frames, 3)).astype(np.float32),
        "bins": random.integers(0, 257, rgb[:-1], np.uint16),
        "boxes": random.integers(0, 256, rgb, np.uint8),
        "cameras": random.normal(size=(frames, VIEWS, 16)).astype(np.float32),
        "color": color,
        "map": random.integers(0, 256, rgb, np.uint8),
        "truth": (color // 2 + 40).astype(np.uint8),  # what a linear model can learn
    }
    arrays["action"][0] = 0
    return arrays


def write_recording(
    path: Path,
    frames: int = 8,
    *,
    log: str = "log",
    seed: int = 0,
    hz: float = 5.0,
    recipe: Mapping[str, Any] = RECIPE,
    without: Sequence[str] = (),
    changed: Mapping[str, Any] | None = None,
    captions: Any = None,
) -> dict[str, np.ndarray[Any, Any]]:
    """Write a safetensors file by hand, byte by byte as the format says; returns its arrays."""
    arrays = {name: array for name, array in arrays_of(frames, seed).items() if name not in without}
    arrays.update(changed or {})
    names = {"uint8": "U8", "uint16": "U16", "float32": "F32", "float64": "F64", "int64": "I64"}
    cameras = ["CAM_FRONT", "CAM_BACK"]
    about = {"log": log, "source": "2-0 2-1", "hz": hz, "cameras": cameras, "recipe": recipe}
    header: dict[str, Any] = {"__metadata__": {"drive": json.dumps(about)}}
    if captions is not None:
        header["__metadata__"]["clip"] = json.dumps({"captions": captions})
    place = 0
    for name, array in sorted(arrays.items()):
        offsets = [place, place + array.nbytes]
        header[name] = {"dtype": names[array.dtype.name], "shape": list(array.shape), "data_offsets": offsets}
        place = offsets[1]
    text = json.dumps(header).encode()
    content = b"".join(array.tobytes() for _, array in sorted(arrays.items()))
    path.write_bytes(struct.pack("<Q", len(text)) + text + content)
    return arrays


class Linear(nn.Module):
    """A 1x1 convolution from color and boxes to images, or two with ``width`` channels between them."""

    def __init__(self, width: int = 0, spare: bool = False) -> None:
        super().__init__()
        self.inner: nn.Module = nn.Conv2d(6, 3, 1)
        if width:
            self.inner = nn.Sequential(nn.Conv2d(6, width, 1), nn.Conv2d(width, 3, 1))
        self.spare = nn.Parameter(torch.ones(2)) if spare else None  # without a gradient
        self.register_buffer("mean", torch.zeros(3))
        self.mean: Tensor

    def forward(self, x: Tensor) -> Tensor:
        found: Tensor = self.inner(x)
        return found + self.mean[:, None, None]


class Critic(nn.Module):
    """A second player, whose loss depends on the first one's images."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.utils.parametrizations.spectral_norm(nn.Conv2d(3, 2, 3))

    def forward(self, x: Tensor) -> Tensor:
        found: Tensor = self.layer(x)
        return found


class TinyTask:
    """A task of two players; ``noise`` adds random numbers to inputs, ``fail`` makes it fail in a step."""

    def __init__(self, options: Mapping[str, Any], train: TrainOptions) -> None:
        unknown = set(options) - {"noise", "fail", "step", "rank", "critic", "critic_start", "width", "spare"}
        if unknown:
            raise ValueError(f"expected options of the tiny network, found {sorted(unknown)[0]}")
        self.options = options
        network, critic = Linear(int(options.get("width", 0)), bool(options.get("spare"))), Critic()
        matrices = [each for each in network.parameters() if each.ndim > 1]
        vectors = [each for each in network.parameters() if each.ndim == 1]
        groups: list[dict[str, Any]] = [{"params": matrices}, {"params": vectors, "weight_decay": 0.0}]
        self.unused_parameters = bool(options.get("spare"))
        self.players = [Player("network", network, groups)]
        if options.get("critic"):
            group = {"params": list(critic.parameters()), "lr": 4e-4, "betas": (0.5, 0.99), "schedule": "constant"}
            self.players.append(Player("critic", critic, [group], start=int(options.get("critic_start", 0))))
        self.level = 0.0

    def prepare(self, clips: Iterator[Clip]) -> None:
        values = torch.stack([clip.images.float().mean((0, 1, 3, 4)) for clip in islice(clips, 3)]) / 255
        network: Any = self.players[0].module
        network.mean.copy_(values.mean(0))
        self.level = float(values.mean())

    def draw(self, clips: Sequence[Clip], step: int, seed: int, rank: int) -> Any:
        if self.options.get("fail") == "draw" and step == self.options.get("step", 0):
            os.kill(os.getpid(), 9)
        inputs = torch.stack([torch.cat([clip.color, clip.boxes], 2).flatten(0, 1) for clip in clips]).float() / 255
        images = torch.stack([clip.images.flatten(0, 1) for clip in clips]).float() / 255
        if self.options.get("noise"):
            random = torch.Generator().manual_seed(1000003 * seed + 1009 * step + rank)
            inputs = inputs + 0.1 * torch.randn(inputs.shape, generator=random)
        return {"inputs": inputs, "images": images, "step": step}

    def loss(
        self, player: str, batch: Any, modules: Mapping[str, nn.Module], device: torch.device
    ) -> tuple[Tensor, dict[str, float]]:
        step, options = batch["step"], self.options
        if step == options.get("step", 0) and int(os.environ.get("RANK", "0")) == options.get("rank", 0):
            if options.get("fail") == "memory":
                raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")
            if options.get("fail") == "kill":
                os.kill(os.getpid(), 9)
            if options.get("fail") == "error":
                raise ZeroDivisionError("a defect of the task")
        inputs, images = (batch[name].to(device).flatten(0, 1) for name in ("inputs", "images"))
        if player == "critic":
            assert all(not p.requires_grad for p in self.players[0].module.parameters())
            real, fake = (modules["critic"](x).float().mean() for x in (images, batch["made"].detach()))
            return torch.relu(1 - real) + torch.relu(1 + fake), {}
        made = modules["network"](inputs)
        batch["made"] = made
        loss = (made.float() - images).square().mean()
        if options.get("critic"):
            loss = loss - 0.01 * modules["critic"](made).float().mean()
        if options.get("fail") == "gradient" and step == options.get("step", 0):
            loss = loss + 0 * made.sum().abs().sqrt().clamp(max=0).sum() + (made - made).sum().sqrt()
        if options.get("fail") == "nan" and step == options.get("step", 0):
            loss = loss * float("nan")
        return loss, {"level": self.level}

    def pictures(self, clip: Clip, modules: Mapping[str, nn.Module]) -> Tensor:
        inputs = torch.cat([clip.color, clip.boxes], 2)[0].float() / 255
        made = (modules["network"](inputs) * 255).clamp(0, 255).to(torch.uint8)
        return torch.cat([made, clip.images[0]])

    def scores(self, clip: Clip, modules: Mapping[str, nn.Module]) -> dict[str, float]:
        inputs = torch.cat([clip.color, clip.boxes], 2).flatten(0, 1).float() / 255
        error = modules["network"](inputs).float() - clip.images.flatten(0, 1).float() / 255
        return {"square": float(error.square().mean()), "frame": float(clip.frame)}

    def weights(self, modules: Mapping[str, nn.Module]) -> tuple[dict[str, Tensor], dict[str, str]]:
        return dict(modules["network"].state_dict()), {"format": "tiny"}

    def state(self) -> dict[str, Any]:
        return {"level": self.level}

    def load_state(self, state: dict[str, Any]) -> None:
        self.level = state["level"]


def task(options: Mapping[str, Any], train: TrainOptions) -> TinyTask:
    return TinyTask(options, train)


def write_config(
    path: Path,
    *,
    train: Mapping[str, Any] | None = None,
    data: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Path:
    """Write a configuration of the tiny task."""
    tables = {
        "train": {"steps": 6, "learning_rate": 0.02, "checkpoint": 2, "validate": 3, **(train or {})},
        "data": {"frames": 2, **(data or {})},
        "options": options or {},
    }
    lines = ['network = "train_base:task"']
    for name, table in tables.items():
        lines += [f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in table.items())]
    path.write_text("\n".join(lines))
    return path


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(each)}" for key, each in value.items()) + "}"
    return json.dumps(value)


def environment(**more: str) -> dict[str, str]:
    """Return variables of a child process that finds the task."""
    paths = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths)), "OMP_NUM_THREADS": "1", **more}


class Done(NamedTuple):
    """A run of the command that ended."""

    returncode: int
    stderr: str


def run(*arguments: object, check: bool = True) -> Done:
    """Run the command in this process, which has imported PyTorch."""
    from pskel.train.__main__ import main

    said, threads = io.StringIO(), torch.get_num_threads()
    torch.set_num_threads(1)  # as in processes of their own: sums depend on it
    try:
        with redirect_stderr(said):
            status = main([str(argument) for argument in arguments])
    finally:
        torch.set_num_threads(threads)
    assert not check or status == 0, said.getvalue()
    return Done(status, said.getvalue())


def start(*arguments: object, rank: int | None = None, port: int = 0) -> subprocess.Popen[str]:
    """Start the command in a process of its own, or one of two that talk by gloo, as ``torchrun`` starts them."""
    variables = environment()
    if rank is not None:
        variables |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2"}
        variables |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "CUDA_VISIBLE_DEVICES": ""}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=variables)


def run_two(*arguments: object, port: int) -> list[Done]:
    """Run a program in two processes."""
    started = [start(*arguments, rank=rank, port=port) for rank in range(2)]
    try:
        said = [process.communicate(timeout=300)[1] for process in started]
    finally:
        for process in started:
            process.kill()
    return [Done(process.returncode, text) for process, text in zip(started, said)]


def weights_of(out: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return tensors and header of ``weights.safetensors``, the header without the command of the training."""
    from safetensors import safe_open

    with safe_open(out / "weights.safetensors", "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}
        header = dict(file.metadata())
    training = json.loads(header.pop("training"))
    assert training.pop("command").startswith("python -m pskel.train ")
    return tensors, {**header, **{name: json.dumps(value) for name, value in training.items()}}


def assert_equal_weights(one: Path, other: Path) -> None:
    """The same tensors to the bit, and the same header but for the command."""
    (tensors, header), (others, other_header) = weights_of(one), weights_of(other)
    assert header == other_header and tensors.keys() == others.keys()
    assert all(tensors[name].numpy().tobytes() == others[name].numpy().tobytes() for name in tensors)


def losses(out: Path) -> list[dict[str, float]]:
    """Return the rows of ``loss.csv``."""
    with open(out / "loss.csv", newline="") as file:
        return [{key: float(value) for key, value in row.items() if value} for row in csv.DictReader(file)]


if __name__ == "__main__":  # several trainings in the same processes, since importing PyTorch takes seconds
    from pskel.train.__main__ import end, main

    end(next((status for status in map(main, json.loads(sys.argv[1])) if status), 0))
