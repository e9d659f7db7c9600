"""Trainings of the paper and of its authors: `python -m pskel.models.pas.training.presets NAME` prints a configuration.

The authors' published configurations differ from the paper. Each preset says what it follows.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ..._rig import CameraNumbers

__all__ = ["PRESETS", "Preset", "configuration", "main"]


class Preset(NamedTuple):
    """Numbers of a training."""

    follows: str
    starts_from: str
    """Checkpoint."""
    recipe: Mapping[str, Any]
    """How maps are rendered: keys of the denoiser protocol."""
    frames: int
    hz: float
    stride_s: float
    """Time from the start of a clip to that of the next."""
    learning_rate: float
    clips: int
    """Clips per process."""
    processes: int
    steps: int | None
    """``None``: ten passes over the clips."""
    prompt: str
    with_points: bool = True
    """Whether color and depth are conditions; without, their adapter is neither used nor trained."""
    drop_action: float = 0.2
    """0 in the authors' nuPlan configurations: their key for it is misspelt, so that it has no effect."""
    camera_numbers: CameraNumbers = "fx,fy,cx,cy"
    variants: int = 1
    """Variants of each log: all but the first have degraded assets."""


_NUSCENES = {
    "drawn": "900x1600",
    "size": "256x448",
    "splat": "15:2,35:1,100:0",
    "radius_m": 50.0,
    "color_filter": "bilinear",
    "bins": {"far_m": 50.0},
    "template_fit": "none",
    "line_width": "scaled",
}
_NUPLAN = {
    **_NUSCENES,
    "drawn": "1080x1920",
    "size": "224x448",
    "splat": "25:1,50:0",
    "radius_m": 100.0,
    "bins": {"far_m": 100.0},
    "map_layers": "dividers",
}
"""Of the training. The authors' simulator, and ``--recipe pas-nuplan``, take 150 m: 2/3 of the trained depth values."""
_FAR = {"radius_m": 100.0, "bins": {"far_m": 100.0}}

_VARIANTS = 5
"""Four of five variants degrade 0.8 of their assets, 0.64 in sum; the paper states 0.8 of all."""

_OPENDWM = "OpenDWM's checkpoint ctsd_35_df16_tirda_bm_nwao_40k"
_PER_CAMERA = "per frame and camera: time, weather, environment, objects, description, in random order"
_PER_LOG = "time. weather (in random order). This is a nuplan video clip from LOCATION"

PRESETS: Mapping[str, Preset] = {
    "nuscenes": Preset(
        follows="the authors' code",
        starts_from=_OPENDWM,
        recipe=_NUSCENES,
        frames=12,
        hz=6.0,
        stride_s=0.5,
        learning_rate=7e-5,
        clips=2,
        processes=8,
        steps=16_000,
        prompt=_PER_CAMERA,
    ),
    "nuplan-layout": Preset(
        follows="the authors' code, first stage",
        starts_from=_OPENDWM,
        recipe=_NUPLAN,
        frames=10,
        hz=5.0,
        stride_s=0.3,
        learning_rate=6e-5,
        clips=1,
        processes=6,
        steps=None,
        prompt=_PER_LOG,
        with_points=False,
        drop_action=0.0,
        camera_numbers="fx,0,cx,fy",
    ),
    "nuplan": Preset(
        follows="the authors' code, second stage",
        starts_from="the weights of nuplan-layout",
        recipe=_NUPLAN,
        frames=10,
        hz=5.0,
        stride_s=0.3,
        learning_rate=6e-5,
        clips=1,
        processes=1,
        steps=None,
        prompt=_PER_LOG,
        drop_action=0.0,
        camera_numbers="fx,0,cx,fy",
    ),
    "paper-nuscenes": Preset(
        follows="the paper; what it does not state is the authors' code",
        starts_from=_OPENDWM,
        recipe={**_NUSCENES, **_FAR},
        frames=12,
        hz=6.0,
        stride_s=0.5,
        learning_rate=6e-5,
        clips=2,
        processes=8,
        steps=15_000,
        prompt=_PER_CAMERA,
    ),
    "paper-nuplan": Preset(
        follows="the paper, with its instance augmentation; what it does not state is the authors' code",
        starts_from=_OPENDWM,
        recipe=_NUPLAN,
        frames=10,
        hz=5.0,
        stride_s=0.3,
        learning_rate=6e-5,
        clips=2,
        processes=8,
        steps=15_000,
        prompt="WEATHER. A driving scene in CITY",
        variants=_VARIANTS,
    ),
}
"""Common to all: AdamW (0.9, 0.999) with weight decay 0.01 on every tensor, a constant rate, no clipping, no EMA."""


def configuration(name: str) -> str:
    """Return the configuration of a preset for ``python -m pskel.train``, as TOML."""
    preset = PRESETS[name]
    recipe = ", ".join(f"{key} = {_toml(value)}" for key, value in preset.recipe.items())
    steps = preset.steps or 10_000
    note = "" if preset.steps else "  # the authors: 10 passes over the clips"
    variants = f"\nvariants = {preset.variants}" if preset.variants > 1 else ""
    return f"""\
# Follows {preset.follows}. Starts from {preset.starts_from}.
# {preset.processes} process(es), one per GPU. Captions: {preset.prompt}.
network = "pas"

[train]
steps = {steps}{note}
batch = {preset.clips}
learning_rate = {preset.learning_rate:g}
precision = "bf16"

[data]
frames = {preset.frames}
hz = {preset.hz:g}
stride = {round(preset.stride_s * _label_rate(preset))}{variants}
recipe = {{ {recipe} }}

[pas]
preset = "{name}"
base = "sd35"
weights = "start.pth"
train = "all"
"""


def _label_rate(preset: Preset) -> float:
    """Rate of the log's frames: 12 Hz of nuScenes's interpolated labels, 20 Hz of nuPlan's sweeps."""
    return 12.0 if preset.hz == 6.0 else 20.0


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + " }"
    return json.dumps(value)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the configuration of a preset; returns the exit status."""
    names = sys.argv[1:] if arguments is None else list(arguments)
    if len(names) != 1 or names[0] not in PRESETS:
        print(f"pskel.models.pas.training.presets: expected a name of {', '.join(PRESETS)}", file=sys.stderr)
        return 2
    print(configuration(names[0]), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
