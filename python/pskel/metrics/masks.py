"""Masks of vehicles in generated images: `python -m pskel.metrics.masks ROLLOUT --mask2former DIR` (docs/src/guide/evaluation.md)."""

from __future__ import annotations

import argparse
import hashlib
import io
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from .._whole import write_whole
from ..models._files import MODEL, expect_folder, first_line
from .cache import digest_of_file
from .images import Video, read_rollout

_PROGRAM = "pskel.metrics.masks"
VEHICLES = frozenset({"car", "truck", "bus", "train", "caravan", "trailer"})
"""Labels of the category `vehicle` of Cityscapes without two-wheelers, as class 1 of class maps: in maps, those include riders."""
_KEY = "source"

Segmentor = Callable[[np.ndarray], np.ndarray]
"""Returns the mask of vehicles, [H, W], bool, of an image [H, W, 3], uint8."""


class Mask2Former:
    """Mask2Former of transformers, trained on the classes of Cityscapes."""

    def __init__(self, folder: str | os.PathLike[str], device: str = "cpu") -> None:
        """Read a folder of `save_pretrained` with model and image processor; nothing is downloaded.

        Raises ValueError if files are missing, of another model, or if the model has other classes.
        """
        try:
            import scipy  # noqa: F401 # needed by the model's constructor
            from transformers import AutoImageProcessor, Mask2FormerForUniversalSegmentation
        except ImportError as error:
            raise ValueError(f"expected the packages transformers and scipy, found none: {error}") from error
        root = expect_folder(folder, "Mask2Former", [(".", (*MODEL, ("preprocessor_config.json",)))])
        try:
            self._processor = AutoImageProcessor.from_pretrained(root, local_files_only=True)
            network = Mask2FormerForUniversalSegmentation.from_pretrained(root, local_files_only=True)
        except Exception as error:  # of many types, by what is wrong in the files
            raise ValueError(f"expected a folder of Mask2Former, found another ({first_line(error)}): {root}") from error
        labels = {str(name).lower(): int(number) for number, name in network.config.id2label.items()}
        if not {"car", "road"} <= labels.keys():
            found = ", ".join(sorted(labels)[:3])
            raise ValueError(f"expected the semantic classes of Cityscapes, found {len(labels)} others ({found}, ..): {root}")
        self._vehicles = [number for name, number in labels.items() if name in VEHICLES]
        self._network = network.to(device).eval()
        self._device = device
        digest = hashlib.sha256()
        for path in sorted(path for path in root.iterdir() if path.suffix in {".json", ".safetensors", ".bin"}):
            digest.update(digest_of_file(path).encode())
        self.digest: str = digest.hexdigest()
        """SHA-256 of all files that masks depend on."""

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Return the mask of vehicles, [H, W], bool, of an image [H, W, 3], uint8."""
        import torch

        inputs = self._processor(images=[image], return_tensors="pt").to(self._device)
        with torch.inference_mode():
            outputs = self._network(**inputs)
        classes = self._processor.post_process_semantic_segmentation(outputs, target_sizes=[image.shape[:2]])[0]
        return np.isin(classes.cpu().numpy(), self._vehicles)


def write_masks(rollout: str | os.PathLike[str], out: Path, segmentor: Segmentor, digest: str) -> tuple[int, int]:
    """Write OUT/NNNNNN/CAM.png, vehicles 255, for all generated images of a rollout; returns how many are new, and all.

    Masks that are there are left if their `digest` (of the segmentor) and image are the same. Raises ValueError if an image is
    missing, or if a mask is another file.
    """
    new = total = 0
    for video in read_rollout(rollout, truth=False):
        for step, path in zip(video.steps, video.generated.paths, strict=True):
            total += 1
            target = out / f"{step:06}" / f"{video.camera}.png"
            key = hashlib.sha256(f"{digest} {digest_of_file(path)}".encode()).hexdigest()
            if _key_of(target) == key:
                continue
            image = Video("generated", (path,)).read()[0]
            _write(target, segmentor(image), key)
            new += 1
    return new, total


def _key_of(path: Path) -> str | None:
    """Return what a mask was made from; None if there is no mask, or a file that was not written to its end."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            return str(image.info[_KEY]) if _KEY in image.info else ""
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ValueError(f"expected a mask to replace, found another file: {path}") from error


def _write(path: Path, mask: np.ndarray, key: str) -> None:
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    path.parent.mkdir(parents=True, exist_ok=True)
    info = PngInfo()
    info.add_text(_KEY, key)
    buffer = io.BytesIO()
    Image.fromarray(mask.astype(np.uint8) * 255).save(buffer, format="PNG", pnginfo=info)
    write_whole(path, buffer.getvalue())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status, after an error in one line on standard error."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {_PROGRAM}",
        description="Write masks of vehicles in the generated images of rollouts, for `pskel evaluate --masks`.",
    )
    parser.add_argument("rollouts", nargs="+", type=Path, metavar="ROLLOUT", help="folder of pskel generate or pskel simulate --generator")
    parser.add_argument(
        "--mask2former",
        required=True,
        type=Path,
        metavar="DIR",
        help="folder of transformers with a semantic model of Cityscapes, such as mask2former-swin-large-cityscapes-semantic",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the masks of one rollout (default: masks in each ROLLOUT)")
    parser.add_argument("--device", default="cpu", help="device of PyTorch (default: cpu)")
    options = parser.parse_args(arguments)
    if options.out is not None and len(options.rollouts) > 1:
        parser.error(f"expected one ROLLOUT with --out, found {len(options.rollouts)}")
    try:
        segmentor = Mask2Former(options.mask2former, options.device)
        for rollout in options.rollouts:
            out = options.out or rollout / "masks"
            new, total = write_masks(rollout, out, segmentor, segmentor.digest)
            print(f"{new} of {total} masks written, {total - new} were there: {out}")
    except (ValueError, OSError, RuntimeError) as error:
        print(f"{_PROGRAM}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
