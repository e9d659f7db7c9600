"""Generated and ground-truth images of a rollout."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class GeneratedVideo:
    """Images of one camera at the generated planning steps, references excluded: [T, H, W, 3], uint8."""

    camera: str
    steps: list[int]
    generated: np.ndarray
    truth: np.ndarray


def read_rollout(folder: str | os.PathLike[str]) -> list[GeneratedVideo]:
    """Read all cameras of a rollout of `pskel generate` or `pskel simulate --generator`, sorted by name.

    Raises ValueError if it has no generated images, or if the ground truth is missing.
    """
    steps = [step for step in sorted(Path(folder, "steps").glob("[0-9]*")) if _kind(step) == "generated"]
    if not steps:
        raise ValueError(f"expected a rollout with generated images, found none: {folder}")
    cameras = sorted(path.stem for path in (steps[0] / "generated").glob("*.png"))
    numbers = [int(step.name) for step in steps]
    return [
        GeneratedVideo(camera, numbers, _read(steps, "generated", camera), _read(steps, "truth", camera)) for camera in cameras
    ]


def _kind(step: Path) -> str | None:
    try:
        kind = json.loads((step / "generated.json").read_text())["kind"]
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f'expected {{"kind": ..}}, found other content: {step / "generated.json"}') from error
    return str(kind)


def _read(steps: list[Path], kind: str, camera: str) -> np.ndarray:
    from PIL import Image

    images = []
    for step in steps:
        path = step / kind / f"{camera}.png"
        try:
            with Image.open(path) as image:
                images.append(np.asarray(image.convert("RGB")))
        except FileNotFoundError as error:
            raise ValueError(f"expected a {kind} image, found none: {path}") from error
        if images[-1].shape != images[0].shape:
            raise ValueError(f"expected an image of {images[0].shape[:2]}, found {images[-1].shape[:2]}: {path}")
    return np.stack(images)
