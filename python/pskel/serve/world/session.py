"""A session: the cameras and the generator of a rollout, and its chunks."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from threading import Lock
from typing import Any, Protocol

import grpc
import numpy as np
from numpy.typing import NDArray

import pskel
from pskel.alpasim import poses, video_model_pb2
from pskel.alpasim.poses import Matrix

from .. import images
from ..errors import RequestError, invalid
from ..messages import MAX_MESSAGE, sized
from ..scenes import Scene
from .actors import Asked, Cast, asked
from .views import Picture, View

Chunk = video_model_pb2.VideoChunkRequest

#: Largest number of frames in a chunk, and of actors.
MAX_FRAMES, MAX_ACTORS = 256, 4096
#: Largest difference of the time between two frames to that of ``fps``, as a share.
RATE_SHARE = 0.01
#: Largest distance of the first frame's ego to that of the log, meters: the image before it is a recorded one.
START_M = 10.0


class Generator(Protocol):
    """The methods of ``pskel.Generator`` that a session uses."""

    @property
    def references(self) -> int: ...
    @property
    def forecasts(self) -> int: ...
    @property
    def image_size(self) -> tuple[int, int]: ...
    def add_reference(self, renderer: pskel.Renderer, scene: pskel.Scene, images: NDArray[np.uint8]) -> None: ...
    def step(
        self, renderer: pskel.Renderer, scene: pskel.Scene, forecasts: Sequence[pskel.Scene]
    ) -> NDArray[np.uint8]: ...
    def close(self) -> None: ...


@dataclass(frozen=True)
class Settings:
    """Options of a server. ``open`` is ``pskel.Generator`` with all arguments but a scene, ``log``, ``prompt`` and ``noise_seed``."""

    open: Callable[..., Generator]
    fps: float = 30.0
    image_format: int = video_model_pb2.JPEG
    sessions: int = 4
    idle_s: float = 600.0


class Session:
    """A rollout. Its methods are called while ``lock`` is held."""

    def __init__(
        self, name: str, scene: Scene, views: Sequence[View], generator: Generator | None, show_map: bool, settings: Settings
    ) -> None:
        self.name = name
        self.lock = Lock()
        self.used_s = time.monotonic()
        self._scene = scene
        self._views = list(views)
        self._cameras = [view.camera for view in views]
        self._generator = generator
        self._map_renderer = map_renderer(scene) if show_map or generator is None else None
        self._interval_us = 1e6 / settings.fps
        self._fps = settings.fps
        self._format = settings.image_format
        self._cast = Cast(scene.log)
        self._last_us: int | None = None
        self._count = 0

    @property
    def summary(self) -> str:
        """Number of frames, and of actors by where they come from."""
        return f"{self._count} frames, {self._cast.summary}"

    def chunk(self, request: Chunk, context: Any, pool: Executor) -> video_model_pb2.VideoChunkReturn:
        """Return the images of a chunk.

        Raises ``RequestError`` for a wrong request, which changes nothing, and ``Broken`` if the session cannot continue.
        """
        times_us = self._times(request)
        egos = [self._pose(number, at.pose) for number, at in enumerate(request.rig_trajectory.poses)]
        if len(request.dynamic_state.actors) > MAX_ACTORS:
            text = f"expected at most {MAX_ACTORS} actors, found {len(request.dynamic_state.actors)}"
            raise RequestError(grpc.StatusCode.RESOURCE_EXHAUSTED, text)
        actors = asked(request.dynamic_state, times_us, self._scene.origin)
        self._check_size(len(times_us))
        start = self._start(times_us[0], egos[0]) if self._last_us is None else None
        if not context.is_active():
            raise RequestError(grpc.StatusCode.CANCELLED, "expected a caller that waits, found none")
        try:
            scenes = self._states(times_us, egos, actors)
            made = self._generated(start, scenes, context) if self._generator is not None else []
            maps = [self._maps(scene) for scene in scenes] if self._map_renderer is not None else []
            answer = sized(self._answer(made, maps, pool))
        except Exception as error:
            raise Broken(error) from error
        self._last_us = times_us[-1]
        self._count += len(times_us)
        return answer

    def close(self) -> None:
        """End the generator."""
        if self._generator is not None:
            self._generator.close()

    def _times(self, request: Chunk) -> list[int]:
        """Return the checked times of the frames. Raises ``RequestError``."""
        times_us = [at.timestamp_us for at in request.rig_trajectory.poses]
        if not 1 <= len(times_us) <= MAX_FRAMES:
            raise invalid(f"a rig_trajectory of 1 to {MAX_FRAMES} poses, one per frame", len(times_us))
        for before, after in zip(times_us, times_us[1:], strict=False):
            if not self._is_next(before, after):
                raise invalid(f"frames every {self._interval_us:.0f} us (--fps {self._fps:g})", f"{after} after {before}")
        if self._last_us is not None and not self._is_next(self._last_us, times_us[0]):
            text = f"expected the next frame at {round(self._last_us + self._interval_us)} us (--fps {self._fps:g}), found {times_us[0]}"
            raise RequestError(grpc.StatusCode.FAILED_PRECONDITION, text)
        return times_us

    def _is_next(self, before_us: int, after_us: int) -> bool:
        return abs(after_us - before_us - self._interval_us) <= RATE_SHARE * self._interval_us

    def _pose(self, number: int, pose: Any) -> Matrix:
        try:
            return poses.matrix(pose, self._scene.origin)
        except ValueError as error:
            raise RequestError(grpc.StatusCode.INVALID_ARGUMENT, f"rig_trajectory {number}: {error}") from None

    def _states(self, times_us: Sequence[int], egos: Sequence[Matrix], actors: Sequence[Asked]) -> list[pskel.Scene]:
        """Return the states of the frames, with the actors that each has."""
        cast = list(zip(self._cast.roles(actors), actors, strict=True))
        return [
            self._state(
                t_us,
                ego,
                [pskel.Actor(role.track, role.category, role.size, actor.poses[t_us]) for role, actor in cast if t_us in actor.poses],
            )
            for t_us, ego in zip(times_us, egos, strict=True)
        ]

    def _state(self, t_us: int, ego: Matrix, actors: Sequence[pskel.Actor]) -> pskel.Scene:
        return pskel.Scene(ego, self._cameras, actors, name=str(t_us), t_us=t_us, map_of=self._scene.first)

    def _start(self, first_us: int, ego: Matrix) -> pskel.Scene:
        """Return the state of the first frames, which are one interval before the first chunk: that of the log.

        Raises ``RequestError`` if the log has no such time or its ego is elsewhere.
        """
        log, t_us = self._scene.log, round(first_us - self._interval_us)
        start_us, end_us = log.times_us[0], log.times_us[-1]
        if abs(start_us - t_us) <= RATE_SHARE * self._interval_us:  # clients round the interval down
            t_us = start_us
        if not start_us <= t_us <= end_us:
            text = f"expected first frames at a time of {log.name}, {start_us} to {end_us} us, found {t_us}"
            raise RequestError(grpc.StatusCode.FAILED_PRECONDITION, text)
        scene = log.at(t_us)
        away = float(np.linalg.norm(ego[:3, 3] - scene.ego[:3, 3]))
        if away > START_M:
            text = f"expected a first pose within {START_M:g} m of the ego of {log.name} at {t_us} us, found {away:.1f} m (another origin?)"
            raise RequestError(grpc.StatusCode.FAILED_PRECONDITION, text)
        return self._state(t_us, scene.ego, scene.actors)

    def _check_size(self, frames: int) -> None:
        """Raise ``RequestError`` for images that no message holds, before they are generated; sizes of JPEG images are not known."""
        if self._format == video_model_pb2.JPEG:
            return
        kinds = (self._generator is not None) + (self._map_renderer is not None)
        pixels = sum(view.first_frame.shape[0] * view.first_frame.shape[1] for view in self._views)
        if (count := 3 * kinds * frames * pixels) > MAX_MESSAGE:
            text = f"expected at most {MAX_MESSAGE} bytes of images in a chunk, found {count}: ask for fewer frames, or use --encoding jpeg"
            raise RequestError(grpc.StatusCode.RESOURCE_EXHAUSTED, text)

    def _generated(self, start: pskel.Scene | None, scenes: Sequence[pskel.Scene], context: Any) -> list[list[Picture]]:
        """Return the images of each frame and view."""
        generator, renderer = self._generator, self._scene.renderer
        assert generator is not None
        if start is not None:
            self._add_references(generator, start)
        made = []
        for number, scene in enumerate(scenes):
            if not context.is_active():
                raise RequestError(grpc.StatusCode.CANCELLED, "expected a caller that waits, found none")
            pictures = generator.step(renderer, scene, scenes[number + 1 : number + 1 + generator.forecasts])
            made.append([view.image(picture) for view, picture in zip(self._views, pictures, strict=True)])
        return made

    def _add_references(self, generator: Generator, start: pskel.Scene) -> None:
        """Give the generator the first frames as often as it needs references: of a vehicle that stood until then."""
        given = np.stack([view.reference(generator.image_size) for view in self._views])
        for before in reversed(range(generator.references)):
            t_us = round(start.t_us - before * self._interval_us)
            generator.add_reference(self._scene.renderer, self._state(t_us, start.ego, start.actors), given)

    def _maps(self, scene: pskel.Scene) -> list[Picture]:
        """Return the HD map with the boxes of actors, for each view."""
        assert self._map_renderer is not None
        made = []
        for view, camera in zip(self._views, self._cameras, strict=True):
            maps = self._map_renderer.render(pskel.Scene(scene.ego, [camera], scene.actors, map_of=self._scene.first))
            boxes = maps["boxes"][0]
            picture = np.where(boxes.any(axis=-1, keepdims=True), boxes, maps["map"][0]) if "map" in maps else boxes
            made.append(view.projection.image(picture))
        return made

    def _answer(
        self, made: Sequence[Sequence[Picture]], maps: Sequence[Sequence[Picture]], pool: Executor
    ) -> video_model_pb2.VideoChunkReturn:
        def encoded(frames: Sequence[Sequence[Picture]], view: int) -> list[video_model_pb2.Image]:
            data = pool.map(lambda frame: images.encoded(frame[view], self._format, images.QUALITY), frames)
            return [video_model_pb2.Image(data=one, format=self._format) for one in data]  # type: ignore[arg-type]

        outputs = [
            video_model_pb2.CameraOutput(
                camera_logical_id=view.name,
                rgb_frames=encoded(made, number),
                hdmap_condition_frames=encoded(maps, number),
            )
            for number, view in enumerate(self._views)
        ]
        return video_model_pb2.VideoChunkReturn(camera_outputs=outputs)


class Broken(Exception):
    """A chunk that failed after its session had changed: the session ends."""

    def __init__(self, cause: Exception) -> None:
        super().__init__(str(cause))
        self.cause = cause


def map_renderer(scene: Scene) -> pskel.Renderer:
    """Return a renderer of the HD map and boxes, of boxes alone if the log has no HD map."""
    renderer = pskel.Renderer(scene.skeleton, maps=["map", "boxes"], log=scene.log.name)
    try:
        renderer.render(scene.first)
    except ValueError:
        print(f"pskel.serve: {scene.log.name} has no HD map: condition frames show boxes", file=sys.stderr, flush=True)
        renderer = pskel.Renderer(scene.skeleton, maps=["boxes"], log=scene.log.name)
    return renderer
