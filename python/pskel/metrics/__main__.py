"""FID and FVD: `python -m pskel.metrics ROLLOUT.. --inception W.pth --i3d W.pt --out DIR` (docs/src/guide/evaluation.md)."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from .._whole import write_whole
from .cache import save_whole
from .distances import ClipComparison, ImageComparison, compare_clips, compare_images, shorter
from .images import videos_of
from .networks import FeatureNetwork, Inception, Video3d

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
    parser.add_argument(
        "--out", required=True, type=Path, metavar="DIR", help="folder for metrics.json, the NPY files, curve.csv and cached features"
    )
    parser.add_argument("--inception", metavar="FILE", help="weights of torch-fidelity: pt_inception-2015-12-05-6726825d.pth")
    parser.add_argument("--i3d", metavar="FILE", help="weights of I3D with 400 classes: i3d_pretrained_400.pt")
    parser.add_argument("--frames", type=int, default=16, metavar="N", help="frames of a clip, and of a window (default: 16)")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="frames from clip to clip (default: 1)")
    parser.add_argument("--device", default="cpu", help="device of PyTorch (default: cpu)")
    return parser


def _run(options: argparse.Namespace) -> None:
    videos = videos_of(options.rollouts, options.reference)
    out, frames = options.out, options.frames
    out.mkdir(parents=True, exist_ok=True)
    results, curves = {}, {}
    if options.inception is not None:
        inception = Inception(options.inception, out / "cache", options.device)
        images = compare_images(inception, videos, frames)
        results["fid"], curves["fid"] = _write(out, inception, images), images.curve()
    if options.i3d is not None:
        i3d = Video3d(options.i3d, out / "cache", options.device)
        clips = compare_clips(i3d, videos, frames, options.stride)
        results["fvd"], curves["fvd"] = _write(out, i3d, clips), clips.curve()
        for some in videos.values():
            if note := shorter(some, frames):
                print(f"note: {note}", file=sys.stderr)
    write_whole(out / "curve.csv", _csv(curves).encode())
    write_whole(out / "metrics.json", (json.dumps(results, indent=2) + "\n").encode())


def _write(out: Path, network: FeatureNetwork, comparison: ImageComparison | ClipComparison) -> dict[str, object]:
    """Write the features of all videos; prints and returns their distance."""
    for kind, features in comparison.whole.items():
        save_whole(out / f"{network.name}-{kind}.npy", features)
    result = comparison.distance()
    generated, other = (len(features) for features in comparison.whole.values())
    counts = str(generated) if generated == other else f"{generated} and {other}"
    print(f"{network.title} {result['distance']:.4f}, {counts} samples of {result['features']} features")
    return result


def _csv(curves: dict[str, dict[int, float]]) -> str:
    rows = sorted({start for curve in curves.values() for start in curve})
    lines = [",".join(["first_frame", *curves])]
    for start in rows:
        lines.append(",".join([str(start), *(repr(curve[start]) if start in curve else "" for curve in curves.values())]))
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
