"""Estimated memory and operations of the network: `python -m pskel.models.pas.cost` (docs/src/reference/pas.md)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from .._rig import PUBLISHED, Published
from .config import Config
from .network import Conditions, Network, add_residuals

__all__ = ["Cost", "cost", "main"]

_TEXT_TOKENS = 154
_LATENT_SCALE = 8
_LAYOUT_CHANNELS, _POINT_CHANNELS, _IDS = 6, 20, 13
_STEPS = {"nuScenes": 36, "nuPlan": 30}
_GUIDANCE_CALLS = 2
_BF16, _F32 = 2, 4


@dataclass(frozen=True)
class Cost:
    """Counts for one published checkpoint; an operation is a multiplication or an addition of a matrix product."""

    parameters: int
    call_operations: int
    """For one evaluation of a window whose conditions are encoded."""
    frame_operations: int
    """Of the adapters and projections, for one new frame."""
    frame_bytes: int
    """Encoded layout, or points, of a frame in bf16."""
    calls: int
    """Evaluations per planning step, with guidance."""
    message_bytes: int
    """Maps of a window in one call of the denoiser protocol."""

    @property
    def weight_bytes(self) -> int:
        """Weights in bf16."""
        return self.parameters * _BF16

    @property
    def step_operations(self) -> int:
        """Of a planning step with one new frame for both halves of the guidance, all others cached."""
        return self.calls * self.call_operations + _GUIDANCE_CALLS * self.frame_operations


def cost(known: Published, config: Config = Config()) -> Cost:
    """Count parameters and operations on PyTorch's ``meta`` device, without memory for them."""
    with torch.device("meta"):
        network = Network(config).to(torch.bfloat16).eval()
        frames, views, (height, width) = known.frames, len(known.cameras), known.size

        def maps(channels: int) -> torch.Tensor:
            return torch.empty(1, 1, views, channels, height, width)

        def encode() -> Conditions:
            residuals = add_residuals(network.encode_layout(maps(_LAYOUT_CHANNELS)), network.encode_points(maps(_POINT_CHANNELS)))
            tokens = torch.empty(1, 1, views, _TEXT_TOKENS, config.joint_attention_dim)
            text, pooled = network.encode_text(tokens, torch.empty(1, 1, views, config.pooled_projection_dim))
            return Conditions(residuals, text, pooled, network.encode_view(torch.empty(1, 1, views, _IDS)))

        frame, frame_operations = _counted(encode)
        window = Conditions.concatenate([frame] * frames, dim=1)
        latents = torch.empty(1, frames, views, config.in_channels, height // _LATENT_SCALE, width // _LATENT_SCALE)
        timesteps = torch.empty(1, frames, views)
        mask = torch.empty(1, views, views, dtype=torch.bool)
        _, call_operations = _counted(lambda: network(latents, timesteps, window, mask))
    return Cost(
        parameters=sum(parameter.numel() for parameter in network.parameters()),
        call_operations=call_operations,
        frame_operations=frame_operations,
        frame_bytes=sum(residual.numel() for residual in frame.residuals) * _BF16,
        calls=_GUIDANCE_CALLS * _STEPS[known.name],
        message_bytes=frames * views * (_LAYOUT_CHANNELS + _POINT_CHANNELS) * height * width * _F32,
    )


def _counted(run: Callable[[], Any]) -> tuple[Any, int]:
    with torch.inference_mode(), FlopCounterMode(display=False) as counter:
        result = run()
    return result, counter.get_total_flops()


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of docs/src/reference/pas.md; returns the exit status, after an error in one line on standard error."""
    parser = argparse.ArgumentParser(prog="python -m pskel.models.pas.cost", description=__doc__.split(":")[0] + ".")
    parser.add_argument("--config", metavar="F.json", help="sizes of the network (default: the published checkpoints)")
    parser.add_argument("--training", action="store_true", help="of training, in place of inference")
    names = [known.name for known in PUBLISHED]
    parser.add_argument("--clips", choices=names, default=names[0], help=f"clips of the training (default: {names[0]})")
    parser.add_argument(
        "--rate", type=float, default=400.0, metavar="T", help="10^12 operations per second in training (default: 400)"
    )
    parser.add_argument(
        "--measure", metavar="N", type=int, help="take steps with random weights on a GPU, for column N of --training"
    )
    options = parser.parse_args(arguments)
    try:
        config = Config() if options.config is None else Config.read(options.config)
        if options.training:
            _print(*_training(config, options))
        else:
            costs = [cost(known, config) for known in PUBLISHED]
            _print("", names, _rows(costs))
    except (ValueError, OSError) as error:
        print(f"pskel.models.pas.cost: {error}", file=sys.stderr)
        return 1
    return 0


def _print(title: str, names: Sequence[str], rows: Iterable[tuple[str, list[str]]]) -> None:
    """Print a table in Markdown."""
    print(f"| {title + ' ' if title else ''}| " + " | ".join(names) + " |")
    print("|---" * (1 + len(names)) + "|")
    for name, values in rows:
        print("| " + " | ".join((name, *values)) + " |")


def _training(config: Config, options: argparse.Namespace) -> tuple[str, list[str], list[tuple[str, list[str]]]]:
    """Title, columns and rows of the training table."""
    from .training.memory import RUNS, cost, measured, table

    if not options.rate > 0:
        raise ValueError(f"expected --rate above 0, found {options.rate:g}")
    if options.measure is not None and not 1 <= options.measure <= len(RUNS):
        raise ValueError(f"expected --measure of 1 to {len(RUNS)}, found {options.measure}")
    if options.measure is not None and not torch.cuda.is_available():
        raise ValueError("expected a GPU for --measure, found none")
    known = next(known for known in PUBLISHED if known.name == options.clips)
    rows = list(table([cost(run, known, config) for run in RUNS], options.rate))
    if options.measure is not None:
        seconds, peak = measured(RUNS[options.measure - 1], known, config)
        texts = [""] * len(RUNS)
        texts[options.measure - 1] = f"{seconds:.2f} s, {peak / 1e9:.1f} GB"
        rows.append((f"measured on {torch.cuda.get_device_name()}: time and peak for 1 clip", texts))
    size = f"{known.size[0]}x{known.size[1]}, {known.frames} frames, {len(known.cameras)} cameras"
    return size, [run.train for run in RUNS], rows


def _rows(costs: Sequence[Cost]) -> list[tuple[str, list[str]]]:
    frames = [2 * known.frames for known in PUBLISHED]
    return [
        ("network, bf16", [f"{cost.weight_bytes / 1e9:.1f} GB" for cost in costs]),
        (
            "conditions of a frame per adapter; of `--cached-frames` frames",
            [
                f"{cost.frame_bytes / 1e6:.0f} MB; {2 * count * cost.frame_bytes / 1e9:.1f} GB"
                for count, cost in zip(frames, costs)
            ],
        ),
        ("operations per evaluation of the network", [f"{cost.call_operations / 1e12:.0f} T" for cost in costs]),
        ("operations of the adapters and projections per new frame", [f"{cost.frame_operations / 1e12:.1f} T" for cost in costs]),
        ("evaluations per planning step with guidance 2", [str(cost.calls) for cost in costs]),
        ("operations per planning step", [f"{cost.step_operations / 1e15:.1f} P" for cost in costs]),
        ("maps in a call of the protocol", [f"{cost.message_bytes / 1e9:.1f} GB" for cost in costs]),
    ]


if __name__ == "__main__":
    sys.exit(main())
