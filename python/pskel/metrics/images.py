"""Image files of rollouts and references."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_SUFFIXES = {".png", ".jpg", ".jpeg"}


@dataclass(frozen=True)
class Video:
    """Image files of one camera, in time order."""

    kind: str
    """generated, truth or reference."""
    paths: tuple[Path, ...]
    size: tuple[int, int] | None = None
    """Height and width to which images are resized, bilinear with antialiasing; None to leave their size."""

    def __len__(self) -> int:
        return len(self.paths)

    def read(self) -> np.ndarray:
        """Return the images: [T, H, W, 3], uint8.

        Raises ValueError with the path of a file that is missing, no image, or of another size than the first.
        """
        images = []
        for path in self.paths:
            images.append(_read(path, self.kind, self.size))
            if images[-1].shape != images[0].shape:
                raise ValueError(f"expected an image of {images[0].shape[:2]}, found {images[-1].shape[:2]}: {path}")
        return np.stack(images)


@dataclass(frozen=True)
class GeneratedVideo:
    """Images of one camera at the generated planning steps, references excluded."""

    camera: str
    steps: list[int]
    generated: Video
    truth: Video | None
    """Ground truth; None if it was not looked for."""


def read_rollout(folder: str | os.PathLike[str], *, truth: bool = True) -> list[GeneratedVideo]:
    """Find the images of all cameras in a rollout by `pskel generate` or `pskel simulate --generator`, sorted by name.

    `truth=False` finds no ground truth, which rollouts off the log do not have. Raises ValueError if there are no generated
    images, or if an image or the ground truth is missing.
    """
    steps = [step for step in _steps(folder) if _kind(step) == "generated"]
    if not steps:
        raise ValueError(f"expected a rollout with generated images, found none: {folder}")
    cameras = sorted(path.stem for path in (steps[0] / "generated").glob("*.png"))
    numbers = [int(step.name) for step in steps]

    def find(kind: str, camera: str) -> Video:
        paths = tuple(step / kind / f"{camera}.png" for step in steps)
        for path in paths:
            if not path.is_file():
                advice = "; --reference compares with other images" if kind == "truth" else ""
                raise ValueError(f"expected a {kind} image, found none: {path}{advice}")
        return Video(kind, paths)

    return [
        GeneratedVideo(camera, numbers, find("generated", camera), find("truth", camera) if truth else None) for camera in cameras
    ]


def read_reference(folder: str | os.PathLike[str], size: tuple[int, int]) -> list[Video]:
    """Find recorded images, which are resized to `size` (height, width) when they are read.

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
    return [Video("reference", tuple(paths), size) for paths in videos]


def videos_of(rollouts: Sequence[str | os.PathLike[str]], references: Sequence[str | os.PathLike[str]] | None) -> dict[str, list[Video]]:
    """Find the videos to compare, by kind: generated, then truth, or reference if references are given.

    Raises ValueError as `read_rollout` and `read_reference`.
    """
    found = [video for rollout in rollouts for video in read_rollout(rollout, truth=references is None)]
    generated = [video.generated for video in found]
    if references is None:
        return {"generated": generated, "truth": [video.truth for video in found if video.truth is not None]}
    height, width, _ = Video("generated", generated[0].paths[:1]).read()[0].shape
    return {"generated": generated, "reference": [video for folder in references for video in read_reference(folder, (height, width))]}


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


def _read(path: Path, kind: str, size: tuple[int, int] | None) -> np.ndarray:
    from PIL import Image

    try:
        with Image.open(path) as image:
            rgb = image.convert("RGB")
    except FileNotFoundError as error:
        raise ValueError(f"expected a {kind} image, found none: {path}") from error
    except OSError as error:
        raise ValueError(f"expected a {kind} image, found another file: {path}") from error
    if size is not None and rgb.size != (size[1], size[0]):
        rgb = rgb.resize((size[1], size[0]), Image.Resampling.BILINEAR)
    return np.asarray(rgb)
