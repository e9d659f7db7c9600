"""Generated, ground-truth and reference images."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_SUFFIXES = {".png", ".jpg", ".jpeg"}


@dataclass(frozen=True)
class GeneratedVideo:
    """Images of one camera at the generated planning steps, references excluded: [T, H, W, 3], uint8."""

    camera: str
    steps: list[int]
    generated: np.ndarray
    truth: np.ndarray | None
    """Ground truth; None if it was not read."""


def read_rollout(folder: str | os.PathLike[str], *, truth: bool = True) -> list[GeneratedVideo]:
    """Read all cameras of a rollout by `pskel generate` or `pskel simulate --generator`, sorted by name.

    `truth=False` reads no ground truth, which rollouts off the log do not have. Raises ValueError if there are no generated
    images, or if the ground truth is to be read and missing.
    """
    steps = [step for step in _steps(folder) if _kind(step) == "generated"]
    if not steps:
        raise ValueError(f"expected a rollout with generated images, found none: {folder}")
    cameras = sorted(path.stem for path in (steps[0] / "generated").glob("*.png"))
    numbers = [int(step.name) for step in steps]

    def read(kind: str, camera: str) -> np.ndarray:
        return _read([step / kind / f"{camera}.png" for step in steps], kind)

    return [
        GeneratedVideo(camera, numbers, read("generated", camera), read("truth", camera) if truth else None) for camera in cameras
    ]


def read_reference(folder: str | os.PathLike[str], size: tuple[int, int]) -> list[np.ndarray]:
    """Read recorded images as videos [T, H, W, 3], uint8, resized to `size` (height, width), bilinear with antialiasing.

    `folder` is a rollout with ground truth, a folder with one image folder per camera, or an image folder of
    one camera. Images are in the order of their names. Raises ValueError if there are none.
    """
    steps = [step / "truth" for step in _steps(folder) if (step / "truth").is_dir()]
    if steps:
        cameras = sorted(path.stem for path in steps[0].glob("*.png"))
        videos = [[step / f"{camera}.png" for step in steps] for camera in cameras]
    else:
        folders = [Path(folder), *sorted(path for path in Path(folder).glob("*") if path.is_dir())]
        videos = [images for images in map(_images, folders) if images]
    if not videos:
        raise ValueError(f"expected a rollout with ground truth, or a folder of PNG or JPEG images, found neither: {folder}")
    return [_read(paths, "reference", size) for paths in videos]


def _steps(folder: str | os.PathLike[str]) -> list[Path]:
    return sorted(Path(folder, "steps").glob("[0-9]*"))


def _images(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)


def _kind(step: Path) -> str | None:
    try:
        kind = json.loads((step / "generated.json").read_text())["kind"]
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f'expected {{"kind": ..}}, found other content: {step / "generated.json"}') from error
    return str(kind)


def _read(paths: list[Path], kind: str, size: tuple[int, int] | None = None) -> np.ndarray:
    from PIL import Image

    images = []
    for path in paths:
        try:
            with Image.open(path) as image:
                rgb = image.convert("RGB")
        except FileNotFoundError as error:
            advice = "; --reference compares with other images" if kind == "truth" else ""
            raise ValueError(f"expected a {kind} image, found none: {path}{advice}") from error
        except OSError as error:
            raise ValueError(f"expected a {kind} image, found another file: {path}") from error
        if size is not None and rgb.size != (size[1], size[0]):
            rgb = rgb.resize((size[1], size[0]), Image.Resampling.BILINEAR)
        images.append(np.asarray(rgb))
        if images[-1].shape != images[0].shape:
            raise ValueError(f"expected an image of {images[0].shape[:2]}, found {images[-1].shape[:2]}: {path}")
    return np.stack(images)
