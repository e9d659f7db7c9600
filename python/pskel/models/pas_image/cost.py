"""Estimated memory and time: `python -m pskel.models.pas_image.cost` (docs/src/reference/pas.md)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch

from .._cost import counted
from .._rig import PUBLISHED
from .config import LATENT_SCALE, TEXT_TOKENS, TINY, Config
from .network import IDS, LAYOUT_CHANNELS, POINT_CHANNELS, Conditions, Network, add_residuals
from .presets import PRESETS, Preset

__all__ = ["Cost", "cost", "main"]

_PROGRAM = "pskel.models.pas_image.cost"
_GUIDANCE_CALLS = 2
_BF16, _F32 = 2, 4


@dataclass(frozen=True)
class Cost:
    """Counts for inference with a preset; an operation is a multiplication or an addition of a matrix product."""

    parameters: int
    call_operations: int
    """For one evaluation of a window whose conditions are encoded."""
    frame_operations: int
    """Of the adapters and embeddings, for one new frame."""
    frame_bytes: int
    """Encoded layout, or points, of a frame in bf16."""
    cached_frames: int
    """Frames of which both remain in memory, by default."""
    calls: int
    """Evaluations per planning step, with guidance."""
    message_bytes: int
    """Maps of a window in one call of the denoiser protocol."""

    @property
    def step_operations(self) -> int:
        """Of a planning step with one new frame for both halves of the guidance, all others cached."""
        return self.calls * self.call_operations + _GUIDANCE_CALLS * self.frame_operations


def cost(preset: Preset, views: int, config: Config = Config()) -> Cost:
    """Count parameters and operations for ``views`` cameras on PyTorch's ``meta`` device, without memory for them."""
    height, width = map(int, preset.recipe["size"].split("x"))
    with torch.device("meta"), torch.inference_mode():
        network = Network(config).to(torch.bfloat16).eval()

        def images(*shape: int, frames: int = 1) -> torch.Tensor:
            return torch.empty(1, frames, views, *shape)

        def encode() -> Conditions:
            layout = network.encode_layout(images(LAYOUT_CHANNELS, height, width))
            points = network.encode_points(images(POINT_CHANNELS, height, width))
            text = network.encode_text(images(TEXT_TOKENS, config.cross_attention_dim))
            return Conditions(add_residuals(layout, points), text, network.encode_view(images(IDS)))

        frame, frame_operations = counted(encode)
        window = Conditions.concatenate([frame] * preset.window, dim=1)
        latents = images(config.in_channels, height // LATENT_SCALE, width // LATENT_SCALE, frames=preset.window)
        mask = torch.empty(1, views, views, dtype=torch.bool)
        _, call_operations = counted(lambda: network(latents, torch.empty(1, preset.window), window, mask))
    return Cost(
        parameters=sum(parameter.numel() for parameter in network.parameters()),
        call_operations=call_operations,
        frame_operations=frame_operations,
        frame_bytes=sum(residual.numel() for residual in frame.residuals) * _BF16,
        cached_frames=2 * preset.window,
        calls=_GUIDANCE_CALLS * preset.steps,
        message_bytes=preset.window * views * (LAYOUT_CHANNELS + POINT_CHANNELS) * height * width * _F32,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of docs/src/reference/pas.md; returns the exit status, after an error in one line."""
    parser = argparse.ArgumentParser(prog=f"python -m {_PROGRAM}", description=__doc__.split(":")[0] + ".")
    parser.add_argument("--training", action="store_true", help="of training, in place of inference")
    parser.add_argument(
        "--rate", type=float, default=200.0, metavar="T", help="10^12 operations per second (default: 200)"
    )
    parser.add_argument("--tiny", action="store_true", help="the sizes of the tests")
    parser.add_argument(
        "--measure", action="store_true", help="also take steps with random weights on a GPU, with --training"
    )
    options = parser.parse_args(arguments)
    try:
        _print_tables(options)
    except (ValueError, ImportError) as error:
        print(f"{_PROGRAM}: {error}", file=sys.stderr)
        return 1
    return 0


def _print_tables(options: argparse.Namespace) -> None:
    if not options.rate > 0:
        raise ValueError(f"expected --rate above 0, found {options.rate:g}")
    if options.measure and not options.training:
        raise ValueError("expected --training with --measure, found none")
    if options.measure and not torch.cuda.is_available():
        raise ValueError("expected a GPU for --measure, found none")
    config = TINY if options.tiny else Config()
    if not options.training:
        views = [len(known.cameras) for known in PUBLISHED]
        costs = [cost(preset, count, config) for preset, count in zip(PRESETS.values(), views)]
        heads = [f"{name.removeprefix('pas-image-')}, {count} cameras" for name, count in zip(PRESETS, views)]
        _print("", heads, _rows(costs, options.rate))
        return
    from . import memory

    training = [memory.cost(trained, rank, config) for trained, rank in memory.MODES]
    _print(memory.TITLE, memory.COLUMNS, memory.rows(training, options.rate))
    if options.measure:
        _print_rows(memory.measured_rows(config))


def _rows(costs: Sequence[Cost], rate: float) -> list[tuple[str, list[str]]]:
    return [
        ("network, bf16", [f"{_BF16 * c.parameters / 1e9:.1f} GB" for c in costs]),
        (
            "conditions of a frame per adapter; of `--cached-frames` frames",
            [f"{c.frame_bytes / 1e6:.0f} MB; {2 * c.cached_frames * c.frame_bytes / 1e6:.0f} MB" for c in costs],
        ),
        ("operations per evaluation of the network", [f"{c.call_operations / 1e12:.1f} T" for c in costs]),
        ("operations of the adapters per new frame", [f"{c.frame_operations / 1e12:.2f} T" for c in costs]),
        ("evaluations per planning step with guidance 2", [str(c.calls) for c in costs]),
        ("operations per planning step", [f"{c.step_operations / 1e12:.0f} T" for c in costs]),
        (
            f"time per planning step at {rate:g} T/s",
            [f"{c.step_operations / (rate * 1e12):.2f} s" for c in costs],
        ),
        ("maps in a call of the protocol", [f"{c.message_bytes / 1e6:.0f} MB" for c in costs]),
    ]


def _print(title: str, heads: Sequence[str], rows: Iterable[tuple[str, list[str]]]) -> None:
    """Print a table in Markdown."""
    print(f"| {title + ' ' if title else ''}| " + " | ".join(heads) + " |")
    print("|---" * (1 + len(heads)) + "|")
    _print_rows(rows)


def _print_rows(rows: Iterable[tuple[str, list[str]]]) -> None:
    for name, values in rows:
        print("| " + " | ".join((name, *values)) + " |")


if __name__ == "__main__":
    sys.exit(main())
