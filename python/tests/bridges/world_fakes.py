"""A generator with the methods of ``pskel.Generator``, and a server with it: ``python world_fakes.py SKELETON.. --generator fake``."""

import hashlib
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pskel
from numpy.typing import NDArray
from PIL import Image

Pictures = NDArray[np.uint8]


class Fake:
    """Images that depend on everything that a generator is given: maps, actors, times, prompt, seed, references, forecasts, history.

    ``fake:REFERENCES:FORECASTS``, then any of ``dies`` (at the fourth step) and ``slow`` (0.3 s a step).
    """

    image_size = (56, 100)

    def __init__(self, generator: str, scene: pskel.Scene, *, fps: float, log: str = "", prompt: str = "", **options: Any) -> None:
        name, references, forecasts, *self._traits = generator.split(":")
        if name != "fake" or prompt == "refused":
            raise ValueError(f"expected a generator fake, found {generator} with prompt {prompt!r}")
        if prompt == "broken":
            raise pskel.Error("expected a process that starts, found none")
        self.references, self.forecasts = int(references), int(forecasts)
        self._cameras, self._steps, self._added = scene.cameras, 0, 0
        self._key = f"{fps} {log} {prompt} {options['noise_seed']}"
        self._before: Pictures = np.zeros((len(scene.cameras), *self.image_size, 3), np.uint8)

    def add_reference(self, renderer: pskel.Renderer, scene: pskel.Scene, images: Pictures) -> None:
        assert images.shape == self._before.shape and images.dtype == np.uint8 and self._steps == 0
        self._added += 1
        self._before = self._stamped(images // 2 + self._color(renderer, scene) // 4 + self._before // 4, scene)

    def step(self, renderer: pskel.Renderer, scene: pskel.Scene, forecasts: Sequence[pskel.Scene]) -> Pictures:
        assert self._added == self.references and len(forecasts) <= self.forecasts
        self._steps += 1
        if "dies" in self._traits and self._steps == 4:
            raise pskel.Error("expected an answer, found the end\nof the process")
        if "slow" in self._traits:
            time.sleep(0.3)
        images = self._color(renderer, scene) // 2 + self._before // 4
        self._before = self._stamped(images, scene, *forecasts)
        return self._before

    def close(self) -> None:
        self._steps = -1000

    def _color(self, renderer: pskel.Renderer, scene: pskel.Scene) -> Pictures:
        assert scene.cameras == self._cameras
        height, width = self.image_size
        made = []
        for name in scene.cameras:
            one = pskel.Scene(scene.ego, [scene.camera(name)], scene.actors)
            made.append(np.asarray(Image.fromarray(renderer.render(one)["color"][0]).resize((width, height))))
        return np.stack(made)

    def _stamped(self, images: Pictures, *scenes: pskel.Scene) -> Pictures:
        """Times, poses and actors of scenes as bytes of the first row."""
        known = [
            (scene.t_us, scene.ego.tobytes(), [(a.track, a.category, a.size, a.global_from_box.tobytes()) for a in scene.actors])
            for scene in scenes
        ]
        digest = hashlib.sha256(repr((self._key, known)).encode()).digest()
        stamped = images.copy()
        stamped[:, 0, :30] = np.frombuffer(3 * digest[:30], np.uint8).reshape(30, 3)
        return stamped


if __name__ == "__main__":
    from pskel.serve.__main__ import main

    pskel.Generator = Fake  # type: ignore[misc, assignment]
    sys.exit(main(sys.argv[1:]))
