"""The table ``[pas]`` of a training's configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from ..._rig import CAMERA_NUMBERS, CameraNumbers
from .modes import TrainMode
from .presets import PRESETS, Preset
from .step import StepOptions

__all__ = ["TaskOptions", "parse"]

_EXPORTS = ("full", "trained")


@dataclass(frozen=True)
class TaskOptions:
    """Options that ``StepOptions`` does not have. Raises ``ValueError`` for other values."""

    base: str
    """Folder of Stable Diffusion 3.5: autoencoder, text encoders and tokenizers."""
    weights: str = ""
    """Checkpoint to start from, of which the adapter of points may be missing; without it, weights are random."""
    config: str = ""
    """JSON file of sizes; by default those of the published checkpoints."""
    preset: str = "nuscenes"
    """Name in ``PRESETS``: recipe, dropouts, conditions, and camera numbers."""
    train: str = "all"
    """``all``, or ``adapters``, ``points`` and ``lora:R`` joined by ``+``, with the rank R."""
    camera_numbers: CameraNumbers | Literal[""] = ""
    """``fx,fy,cx,cy`` or ``fx,0,cx,fy``; by default those of the preset."""
    export: str = "full"
    """Tensors of the weights: ``full``, or ``trained`` alone, for `python -m pskel.models.pas.training.merge`."""
    checkpointing: bool = True
    """Whether blocks are computed again in the backward pass, so that only their inputs stay in memory."""
    image_batch: int = 12
    """Images that the autoencoder encodes at a time."""
    cached_captions: int = 1000
    """Encoded captions that stay in main memory, 1.3 MB each in half precision."""
    text_on_device: bool = False
    """Whether the text encoders stay on the device (11 GB): faster where each image has a caption of its own."""
    infer_steps: int = 20
    guidance: float = 2.0
    """Inference steps and guidance of validations."""

    def __post_init__(self) -> None:
        TrainMode.parse(self.train)
        numbers = ("", *CAMERA_NUMBERS)
        for name, known in (
            ("preset", tuple(PRESETS)),
            ("camera_numbers", numbers),
            ("export", _EXPORTS),
        ):
            if getattr(self, name) not in known:
                expected = ", ".join(filter(None, known))
                raise ValueError(f"expected {name} of {expected}, found {getattr(self, name)!r}")
        for name, least in (("image_batch", 1), ("cached_captions", 0), ("infer_steps", 1), ("guidance", 0.0)):
            if not getattr(self, name) >= least:
                raise ValueError(f"expected {name} of at least {least}, found {getattr(self, name)}")

    @property
    def chosen(self) -> Preset:
        """The preset."""
        return PRESETS[self.preset]

    @property
    def numbers(self) -> CameraNumbers:
        """The camera numbers."""
        return self.camera_numbers or self.chosen.camera_numbers


def parse(options: Mapping[str, Any]) -> tuple[TaskOptions, StepOptions]:
    """Convert the table; dropouts that it does not name come from the preset. Raises ``ValueError``."""
    kinds = (TaskOptions, StepOptions)
    known = {field.name: (kind, field.default) for kind in kinds for field in fields(kind)}
    if unknown := sorted(set(options) - set(known)):
        raise ValueError(f"expected the options {', '.join(known)}, found {unknown[0]!r}")
    if "base" not in options:
        raise ValueError("expected base, a folder of Stable Diffusion 3.5, found none")
    values: dict[Any, dict[str, Any]] = {kind: {} for kind in kinds}
    for name, value in options.items():
        kind, default = known[name]
        values[kind][name] = _converted(name, value, "" if name == "base" else default)
    task = TaskOptions(**values[TaskOptions])
    chosen = {"drop_action": task.chosen.drop_action, "with_points": task.chosen.with_points}
    return task, StepOptions(**{**chosen, **values[StepOptions]})


def _converted(name: str, value: Any, default: Any) -> Any:
    """Check the type of an option by its default."""
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if isinstance(default, str) and isinstance(value, Path):
        return str(value)
    if type(value) is not type(default):
        raise ValueError(f"expected {name} of type {type(default).__name__}, found {value!r}")
    return value
