"""Logs that are rendered on the fly, and recordings of them.

Variant 0 of a log is as recorded. The others have degraded assets, and in synthetic towns a moved ego with images of
its pose.
"""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DataError, first_line
from .captions import content_of
from .logs import LogMaps, LogReader, Opened
from .recipe import depth_bins, renderer_keywords
from .recorded import Recorder

if TYPE_CHECKING:
    import pskel

__all__ = ["RenderedReader", "RenderedSource", "Variant", "build_skeleton", "record"]

SEED = 1
"""Seed of moved poses and degraded assets. It is not the training's: trainings share recordings."""
BESIDE_M = 3.5
"""Maximum offset of a moved ego to either side."""
TURNED_RAD = 0.1
_OPEN_RENDERERS = 2
"""Renderers of a process; each has its points on the device."""


@dataclass(frozen=True)
class Variant:
    """Difference to the recorded log."""

    number: int = 0
    left_m: float = 0.0
    yaw_rad: float = 0.0
    assets: int | None = None
    """Seed for degrading assets."""

    @property
    def label(self) -> str:
        """Number, with the letter a if assets are degraded."""
        return f"{self.number}{'' if self.assets is None else 'a'}"

    @classmethod
    def create(cls, log: str, number: int, *, town: bool, augment: bool) -> Variant:
        """Return a variant of a log. Only towns are moved: recorded images exist at the recorded poses alone."""
        if number == 0:
            return cls()
        random = np.random.default_rng((SEED, zlib.crc32(log.encode()), number))
        left_m, yaw_rad = (float(random.uniform(-most, most)) if town else 0.0 for most in (BESIDE_M, TURNED_RAD))
        return cls(number, left_m, yaw_rad, SEED ^ number if augment else None)


@dataclass(frozen=True)
class RenderedSource:
    """A log, and how it is rendered."""

    text: str
    """What ``pskel.Log`` opens."""
    skeleton: Path
    recipe: Mapping[str, Any]
    change: Variant = field(default_factory=Variant)
    captions: str | None = None
    """File of captions."""
    rasterizer: str = "auto"

    def key(self) -> str:
        """Return a text that is the same for everything that is rendered alike."""
        parts = (self.text, str(self.skeleton), self.recipe, asdict(self.change), self.rasterizer)
        return json.dumps(parts, sort_keys=True)

    def identity(self) -> str:
        """Return a digest of everything that the maps of a recording depend on."""
        skeleton = self.skeleton / "skeleton.json"
        content = skeleton.read_bytes() if skeleton.is_file() else b""
        text = json.dumps((self.recipe, asdict(self.change)), sort_keys=True)
        return hashlib.sha256(text.encode() + content).hexdigest()[:32]


class RenderedReader(LogReader):
    """A log that is rendered whenever its frames are read."""

    def __init__(self, source: RenderedSource) -> None:
        super().__init__(source.text, source.recipe, source.captions)
        self.rendered = source
        self.change = source.change
        self.variant = source.change.number

    def scene(self, log: pskel.Log, frame: int) -> pskel.Scene:
        """Return the scene at a key frame, with its ego moved."""
        scene, change = log[frame], self.change
        if change.left_m == 0 and change.yaw_rad == 0:
            return scene
        return scene.move_ego(left_m=change.left_m, yaw_deg=float(np.degrees(change.yaw_rad)))

    def maps(self, scene: pskel.Scene, frame: int) -> LogMaps:
        """Render the maps of a scene; the map of a log without an HD map is black."""
        key = self.rendered.key()
        opened = _renderers.pop(key, None)
        if opened is None or opened.process != os.getpid():
            opened = Opened(os.getpid(), _Renderer(self.rendered, self.log))
        while len(_renderers) >= _OPEN_RENDERERS:
            other = _renderers.popitem(last=False)[1]
            if other.process == os.getpid():
                other.value.close()
        _renderers[key] = opened
        renderer: _Renderer = opened.value
        return renderer.render(scene)


_renderers: OrderedDict[str, Opened] = OrderedDict()
"""By everything that a renderer depends on."""


class _Renderer:
    """A renderer of a log, which learns from the first frame whether the log has an HD map."""

    def __init__(self, source: RenderedSource, log: str) -> None:
        self._source = source
        self._log = log
        self._renderer = self._open(["color", "depth", "boxes", "map"])

    def _open(self, maps: list[str]) -> pskel.Renderer:
        import pskel

        source = self._source
        try:
            return pskel.Renderer(
                pskel.Skeleton(source.skeleton),
                maps=maps,
                log=self._log,
                augment=source.change.assets,
                rasterizer=source.rasterizer,
                **renderer_keywords(source.recipe),
            )
        except (pskel.Error, ValueError) as error:
            raise self._failed(error) from error

    def _failed(self, error: Exception) -> DataError:
        return DataError(f"the log cannot be rendered: {first_line(error)}: {self._source.text}")

    def render(self, scene: pskel.Scene) -> LogMaps:
        import pskel

        try:
            maps = self._renderer.render(scene)
        except pskel.Error as error:
            raise self._failed(error) from error
        except ValueError as error:
            if "expected an HD map" not in str(error):
                raise self._failed(error) from error
            self._renderer.close()
            self._renderer = self._open(["color", "depth", "boxes"])
            return self.render(scene)
        bins = depth_bins(maps["depth"], self._source.recipe["bins"])
        return LogMaps(maps["color"], bins, maps["boxes"], maps.get("map", np.zeros_like(maps["color"])))

    def close(self) -> None:
        self._renderer.close()


def build_skeleton(text: str, folder: str) -> None:
    """Build the skeleton of a log. Raises ``DataError``."""
    import pskel

    try:
        pskel.build(pskel.Log(text), folder)
    except (pskel.Error, OSError, ValueError) as error:
        raise DataError(f"the skeleton cannot be built: {first_line(error)}: {text}") from error


def record(source: RenderedSource, path: Path) -> None:
    """Record a log. Raises ``DataError`` if it cannot be rendered or written."""
    reader = RenderedReader(source)
    views = range(len(reader.names))
    frames = [frame for run in reader.runs for frame in run]
    identity = source.identity()
    about = {"log": reader.log, "source": identity, "hz": reader.hz, "cameras": list(reader.names)}
    about["recipe"] = reader.recipe
    clip = {
        "variant": reader.variant,
        "identity": identity,
        "captions": reader.captions,
        "captions_content": content_of(source.captions),
    }
    try:
        with Recorder(path, about, clip, len(frames)) as recorder:
            assert reader.times_us is not None
            recorder.write("t_us", reader.times_us)
            for frame in frames:
                read = reader.read([frame], views)
                for name, tensor in (
                    ("color", read.color),
                    ("boxes", read.boxes),
                    ("map", read.map),
                    ("truth", read.images),
                ):
                    recorder.write(name, tensor[0].permute(0, 2, 3, 1).numpy(), frame)
                recorder.write("bins", read.bins[0].numpy(), frame)
                recorder.write("cameras", read.cameras[0].numpy(), frame)
                recorder.write("action", reader.motion(frame - 1, frame) if frame else np.zeros(3, np.float32), frame)
                recorder.write("global_from_ego", read.global_from_ego[0], frame)
            recorder.write("original_sizes", read.original_sizes)
    except OSError as error:
        raise DataError(f"the recording cannot be written: {error.strerror}: {path}") from error
