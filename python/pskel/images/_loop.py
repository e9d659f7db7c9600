"""The loop of an image generator in one process: simulation, renderer and generator."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ._generator import MAPS, ImageGenerator, ImageRequest, RequestActor, Settings
from ._protocol import check_values

if TYPE_CHECKING:
    from .._pskel import Actor, Log, Renderer, Scene, Simulation

__all__ = ["Images"]

_MAX_INSTANCES = (1 << 16) - 1
#: Largest difference between the ego and the recorded one at a reference, meters and elements of rotations.
_SAME = 1e-3


class Images:
    """Steps a simulation and yields the images of each planning step, ``uint8 [V, h, w, 3]``.

    The first ``references`` images of the generator are the recorded ones (of a town: rendered at the poses), and the generator
    makes the others, as ``pskel simulate --generator images:..`` does. With ``ego="caller"``, plan between them::

        for images in pskel.images.Images(simulation, renderer, generator, log):
            if simulation.needs_plan:
                simulation.act(plan(images, simulation.observation))

    Parameters
    ----------
    simulation : pskel.Simulation
        A simulation at its start, whose ``warmup_frames`` are at least ``references``.
    renderer : pskel.Renderer
        Renders the maps that the generator wants, and maybe others.
    generator : ImageGenerator
        Its ``generate`` gets the committed scene and forecasts.
    log : pskel.Log
        Log of the simulation.
    prompt : str or sequence of str
        Text of each frame, or a caption for each camera.

    Raises ``ValueError`` for a generator or a renderer that does not fit, while iterating for a simulation that leaves the log
    within the references, and for wrong images of the generator.
    """

    def __init__(
        self,
        simulation: Simulation,
        renderer: Renderer,
        generator: ImageGenerator,
        log: Log,
        *,
        prompt: str | Sequence[str] = "",
    ) -> None:
        scene = simulation.scene
        if simulation.index != 0:
            raise ValueError(f"expected a simulation at its start, found one at step {simulation.index}")
        self._simulation, self._renderer, self._generator, self._log = simulation, renderer, generator, log
        self._cameras = tuple(scene.cameras)
        self._settings = Settings.of(generator, len(self._cameras), MAPS)
        self._prompt: str | list[str] = prompt if isinstance(prompt, str) else list(prompt)
        if isinstance(self._prompt, list) and len(self._prompt) != len(self._cameras):
            raise ValueError(f"expected a prompt or {len(self._cameras)} captions, found {len(self._prompt)}")
        self._earlier: deque[npt.NDArray[np.uint8]] = deque(maxlen=self._settings.history)
        self._class_names: dict[str, str] = {}

    def __iter__(self) -> Iterator[npt.NDArray[np.uint8]]:
        for frame, _ in enumerate(self._planning_steps()):
            images = self._recorded(frame) if frame < self._settings.references else self._generated(frame)
            self._earlier.append(images.copy())  # a generator may use its array again, and a caller may change it
            yield images

    def _planning_steps(self) -> Iterator[int]:
        """Step the simulation; yields at each planning step, also during the warm-up and at the end."""
        start_us, stride = self._simulation.scene.t_us, 0
        yield self._simulation.index
        while self._simulation.step():
            if stride == 0:
                step_s = (self._simulation.scene.t_us - start_us) / 1e6
                stride = round(self._simulation.plan_dt / step_s)
            if self._simulation.index % stride == 0:
                yield self._simulation.index

    def _recorded(self, frame: int) -> npt.NDArray[np.uint8]:
        """The recorded images of a reference, which the simulation must not have left."""
        scene = self._simulation.scene
        difference = float(np.abs(scene.ego - self._log.at(scene.t_us).ego).max())
        is_planned_too_early = self._simulation.needs_plan and frame < self._settings.references - 1
        if difference > _SAME or is_planned_too_early:
            expected = f"expected warmup_frames of at least {self._settings.references}, the references of the generator"
            raise ValueError(f"{expected}, found a plan before frame {frame + 1}")
        return self._settings.checked(self._log.images(scene, self._settings.size))

    def _generated(self, frame: int) -> npt.NDArray[np.uint8]:
        forecasts = [forecast.value for forecast in self._simulation.forecast(self._settings.forecasts)]
        return self._settings.checked(self._generator.generate(self._request(frame, [self._simulation.scene, *forecasts])))

    def _request(self, frame: int, scenes: list[Scene]) -> ImageRequest:
        views, settings = len(self._cameras), self._settings
        rendered = [self._maps(scene) for scene in scenes]
        maps = {name: np.stack([maps[name] for maps in rendered]) for name in settings.maps}
        if "instance" in maps:
            if maps["instance"].max(initial=0) > _MAX_INSTANCES:
                raise ValueError(f"expected at most {_MAX_INSTANCES} actors, found {maps['instance'].max()}")
            maps["instance"] = maps["instance"].astype(np.uint16)
        poses = [(scene.ego, np.linalg.inv(scene.ego) @ np.linalg.inv(scene.camera_from_global)) for scene in scenes]
        earlier = list(self._earlier)
        request = ImageRequest(
            frame=frame,
            t_us=[scene.t_us for scene in scenes],
            prompts=[self._prompt for _ in scenes],
            actors=[self._actors(scene) for scene in scenes],
            maps=maps,
            global_from_ego=np.stack([pose for pose, _ in poses]),
            ego_from_camera=np.stack([mounts for _, mounts in poses]),
            intrinsics=np.stack([_intrinsics(scene, next(iter(maps.values()))) for scene, maps in zip(scenes, rendered)]),
            images=np.stack(earlier) if earlier else np.zeros((0, views, *settings.size, 3), np.uint8),
            cameras=self._cameras,
        )
        check_values(request)
        return request

    def _maps(self, scene: Scene) -> dict[str, npt.NDArray[Any]]:
        rendered: Any = self._renderer.render(scene)
        maps: dict[str, npt.NDArray[Any]] = {name: value for name, value in rendered.items() if name in MAPS}
        if missing := [name for name in self._settings.maps if name not in maps]:
            expected = f"expected a renderer of the maps {', '.join(self._settings.maps)}, which the generator wants"
            raise ValueError(f"{expected}, found none of {', '.join(missing)}: pskel.Renderer(.., maps=[..])")
        if not maps:
            raise ValueError(f"expected a renderer of one of the maps {', '.join(MAPS)}, found none")
        return maps

    def _actors(self, scene: Scene) -> list[RequestActor]:
        actors = scene.actors
        if any(actor.category not in self._class_names for actor in actors):
            self._learn_classes(scene)
        return [self._actor(actor) for actor in actors]

    def _actor(self, actor: Actor) -> RequestActor:
        length, width, height = actor.size
        class_name = self._class_names[actor.category]
        return RequestActor(actor.track, actor.category, class_name, (length, width, height), actor.global_from_box)

    def _learn_classes(self, scene: Scene) -> None:
        """Learn the classes of categories from observations: of the simulation, and of the log at the time of a forecast."""
        from .. import Simulation

        at = Simulation(self._log, ego="replay", steps=1, start_us=scene.t_us)
        for observation in (self._simulation.observation, at.observation):
            self._class_names.update((actor["category"], actor["class"]) for actor in observation["actors"])


def _intrinsics(scene: Scene, example: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Intrinsics ``[V, 3, 3]`` in pixels of a map ``[V, H, W, ..]``."""
    height, width = example.shape[1:3]
    scale = np.array([[width / columns, height / rows, 1.0] for rows, columns in scene.sizes])
    scaled: npt.NDArray[np.float64] = scene.intrinsics * scale[:, :, None]
    return scaled
