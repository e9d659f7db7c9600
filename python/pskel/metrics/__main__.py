"""FID and FVD: `python -m pskel.metrics ROLLOUT.. --inception W.pth --i3d W.pt --out DIR` (docs/src/guide/evaluation.md)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .frechet import frechet_distance
from .i3d import I3D, video_features
from .inception import image_features, load_inception
from .rollout import read_reference, read_rollout

_PROGRAM = "pskel.metrics"
_LEAST_FRAMES = 10


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status, after an error in one line on standard error."""
    options = _parser().parse_args(arguments)
    if options.inception is None and options.i3d is None:
        _parser().error("expected --inception or --i3d, found neither")
    if options.frames < _LEAST_FRAMES:
        _parser().error(f"expected --frames of {_LEAST_FRAMES} or more, found {options.frames}")
    try:
        _run(options)
    except (ValueError, OSError, ImportError, RuntimeError) as error:
        print(f"{_PROGRAM}: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"python -m {_PROGRAM}",
        description="Write features of generated and ground-truth (or reference) images of rollouts, and print FID and FVD.",
    )
    parser.add_argument("rollouts", nargs="+", metavar="ROLLOUT", help="folder of pskel generate or pskel simulate --generator")
    parser.add_argument(
        "--reference",
        nargs="+",
        metavar="FOLDER",
        help="compare with these images in place of the ground truth, for rollouts off the log: rollouts with ground truth, or folders of images",
    )
    parser.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder for the NPY files and curve.csv")
    parser.add_argument("--inception", metavar="FILE", help="weights of torch-fidelity: pt_inception-2015-12-05-6726825d.pth")
    parser.add_argument("--i3d", metavar="FILE", help="weights of I3D with 400 classes: i3d_pretrained_400.pt")
    parser.add_argument("--frames", type=int, default=16, metavar="N", help="frames of a clip, and of a window (default: 16)")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="frames from clip to clip (default: 1)")
    parser.add_argument("--device", default="cpu", help="device of PyTorch (default: cpu)")
    return parser


def _run(options: argparse.Namespace) -> None:
    off_log = options.reference is not None
    videos = [video for rollout in options.rollouts for video in read_rollout(rollout, truth=not off_log)]
    compared = {"generated": [video.generated for video in videos]}
    if off_log:
        size = videos[0].generated.shape[1:3]
        compared["reference"] = [video for folder in options.reference for video in read_reference(folder, size)]
    else:
        compared["truth"] = [video.truth for video in videos if video.truth is not None]
    options.out.mkdir(parents=True, exist_ok=True)
    curves: dict[str, dict[int, float]] = {}
    if options.inception is not None:
        network = load_inception(options.inception, options.device)
        sets = {kind: [image_features(network, images) for images in some] for kind, some in compared.items()}
        _write(options.out, "inception", "FID", sets)
        curves["fid"] = _image_curve(sets, options.frames)
    if options.i3d is not None:
        starts = {kind: [_starts(images, options) for images in some] for kind, some in compared.items()}
        for kind, some in starts.items():
            if not any(some):
                longest = max(len(images) for images in compared[kind])
                raise ValueError(f"expected a rollout of {options.frames} {kind} frames or more, found at most {longest}")
        i3d = I3D.load(options.i3d, options.device)
        sets = {
            kind: [
                video_features(i3d, [images[start : start + options.frames] for start in at])
                for images, at in zip(compared[kind], some, strict=True)
            ]
            for kind, some in starts.items()
        }
        _write(options.out, "i3d", "FVD", sets)
        curves["fvd"] = _clip_curve(sets, starts["generated"])
    _write_curve(options.out / "curve.csv", curves)


def _starts(images: np.ndarray, options: argparse.Namespace) -> range:
    """First frame of each clip in a video."""
    return range(0, len(images) - options.frames + 1, options.stride)


def _write(out: Path, network: str, name: str, sets: dict[str, list[np.ndarray]]) -> None:
    whole = {kind: np.concatenate(features) for kind, features in sets.items()}
    for kind, features in whole.items():
        np.save(out / f"{network}-{kind}.npy", features)
    generated, other = whole.values()
    counts = f"{len(generated)} samples" if len(generated) == len(other) else f"{len(generated)} and {len(other)} samples"
    print(f"{name} {frechet_distance(generated, other):.4f}, {counts} of {generated.shape[1]} features")


def _image_curve(sets: dict[str, list[np.ndarray]], frames: int) -> dict[int, float]:
    """Return the distance over the images of each frame window, by its first frame.

    A window of generated images is compared with the ground truth at the same frames, or with all reference
    images.
    """
    generated, truth = sets["generated"], sets.get("truth")
    last = max(len(features) for features in generated) - frames

    def window(features: list[np.ndarray], start: int) -> np.ndarray:
        return np.concatenate([each[start : start + frames] for each in features])

    if truth is not None:
        return {start: frechet_distance(window(generated, start), window(truth, start)) for start in range(last + 1)}
    whole = np.concatenate(sets["reference"])
    return {start: frechet_distance(window(generated, start), whole) for start in range(last + 1)}


def _clip_curve(sets: dict[str, list[np.ndarray]], starts: list[range]) -> dict[int, float]:
    """Return the distance over the clips that begin at the same frame, by that frame, where there are two or more.

    They are compared with the ground truth of the same frames, or with all reference clips.
    """
    generated, truth = sets["generated"], sets.get("truth")
    curve = {}
    for start in sorted({start for some in starts for start in some}):
        which = [(number, some.index(start)) for number, some in enumerate(starts) if start in some]
        if len(which) > 1:
            clips = np.stack([generated[number][row] for number, row in which])
            if truth is not None:
                others = np.stack([truth[number][row] for number, row in which])
            else:
                others = np.concatenate(sets["reference"])
            curve[start] = frechet_distance(clips, others)
    return curve


def _write_curve(path: Path, curves: dict[str, dict[int, float]]) -> None:
    rows = sorted({start for curve in curves.values() for start in curve})
    lines = [",".join(["first_frame", *curves])]
    for start in rows:
        lines.append(",".join([str(start), *(repr(curve[start]) if start in curve else "" for curve in curves.values())]))
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    sys.exit(main())
