"""Answers `pskel protocol`: one JSON object per line on standard input, one per line on standard output.

A request is `{"distances": {..}}` or `{"masks": {..}}`, with the arguments of the function of this name. An answer is its
result, or `{"error": TEXT}`. Networks are loaded once.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from ..models._files import first_line
from .distances import TooShortError, compare_clips, compare_images, shorter
from .images import videos_of
from .masks import Mask2Former, write_masks
from .networks import Inception, Video3d

_FRAMES = 16


class _Server:
    def __init__(self) -> None:
        self._networks: dict[tuple[str, ...], Any] = {}

    def distances(
        self, rollouts: list[str], references: list[str] | None, inception: str | None, i3d: str | None, cache: str, device: str
    ) -> dict[str, object]:
        """Return FID and FVD, None without weights or clips, and notes."""
        videos = videos_of(rollouts, references)
        result: dict[str, object] = {"fid": None, "fvd": None, "notes": []}
        notes: list[str] = []
        if inception is not None:
            network = self._once(Inception, inception, Path(cache), device)
            result["fid"] = compare_images(network, videos, _FRAMES).distance()
        if i3d is not None:
            try:
                comparison = compare_clips(self._once(Video3d, i3d, Path(cache), device), videos, _FRAMES, 1)
                result["fvd"] = comparison.distance()
                notes += [note for some in videos.values() if (note := shorter(some, _FRAMES))]
            except TooShortError as error:
                notes.append(f"no FVD: {error}")
        return {**result, "notes": notes}

    def masks(self, rollout: str, out: str, mask2former: str, device: str) -> dict[str, object]:
        """Write the masks of a rollout; returns how many are new, and all."""
        segmentor = self._once(Mask2Former, mask2former, device)
        new, total = write_masks(rollout, Path(out), segmentor, segmentor.digest)
        return {"new": new, "total": total}

    def _once(self, network: type, *arguments: Any) -> Any:
        key = (network.__name__, *map(str, arguments))
        if key not in self._networks:
            self._networks[key] = network(*arguments)
        return self._networks[key]

    def answer(self, request: dict[str, dict[str, Any]]) -> dict[str, object]:
        """Answer a request."""
        ((name, arguments),) = request.items()
        if name == "distances":
            return self.distances(**arguments)
        if name == "masks":
            return self.masks(**arguments)
        raise ValueError(f"expected distances or masks, found {name}")


def main() -> int:
    """Answer until the input ends."""
    # Libraries print to standard output, which is for answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    server = _Server()
    for line in sys.stdin:
        try:
            answer = server.answer(json.loads(line))
        except Exception as error:  # reported by the one who asked
            answer = {"error": first_line(error)}
        print(json.dumps(answer), file=answers, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
