"""Image generators in one process, with a simulation and a renderer."""

from typing import Any

import numpy as np
import pskel
import pytest
from pskel import images


class Blend(pskel.ImageGenerator):
    """Depends on all that it gets: the mean of filled maps and earlier images."""

    image_size = (56, 100)
    maps = ("color", "depth", "class", "instance", "boxes", "map")
    references = 2
    history = 3
    forecasts = 2

    def __init__(self) -> None:
        self.requests: list[pskel.ImageRequest] = []

    def generate(self, request: pskel.ImageRequest) -> Any:
        self.requests.append(request)
        return np.mean([*request.maps["color"], *request.images], axis=0).astype(np.uint8)


def ahead(observation: Any) -> Any:
    times_s = np.arange(1, 9) * 0.5
    return np.stack([4.0 * times_s, 0 * times_s, 0 * times_s], axis=1)


def test_images_in_one_process(log: pskel.Log, renderer: pskel.Renderer) -> None:
    generator = Blend()
    simulation = pskel.Simulation(log, warmup_frames=2, steps=12)
    made, scenes, forecasts = [], [], []
    for frame, shown in enumerate(images.Images(simulation, renderer, generator, log, prompt="rain")):
        made.append(shown)
        scenes.append(simulation.scene)
        if simulation.needs_plan:
            simulation.act(ahead(simulation.observation))
        assert simulation.index == 2 * frame
    assert len(made) == 7 and [request.frame for request in generator.requests] == [2, 3, 4, 5, 6]
    for frame in range(2):
        np.testing.assert_array_equal(made[frame], log.images(scenes[frame], (56, 100)))
    # Another simulation makes the same states and forecasts.
    again = pskel.Simulation(log, warmup_frames=2, steps=12)
    for _ in again:
        forecasts.append([forecast.value for forecast in again.forecast(2)])
        again.act(ahead(again.observation))
    for request in generator.requests:
        frame = request.frame
        assert request.cameras == tuple(scenes[frame].cameras) and request.prompts == ["rain"] * len(request.t_us)
        np.testing.assert_array_equal(request.images, made[max(frame - 3, 0) : frame])
        np.testing.assert_array_equal(made[frame], np.mean([*request.maps["color"], *request.images], axis=0).astype(np.uint8))
        for n, scene in enumerate([scenes[frame], *(forecasts[frame - 1] if frame <= 5 else [])][: len(request.t_us)]):
            assert request.t_us[n] == scene.t_us
            expected: Any = renderer.render(scene)
            for name, maps in request.maps.items():
                np.testing.assert_array_equal(maps[n], expected[name])
            np.testing.assert_array_equal(request.global_from_ego[n], scene.ego)
            camera_from_global = np.linalg.inv(scene.ego @ request.ego_from_camera[n])
            np.testing.assert_allclose(camera_from_global, scene.camera_from_global, atol=1e-8)
            height, width = scene.sizes[0]
            scale = np.array([[100 / width], [56 / height], [1.0]])
            np.testing.assert_allclose(request.intrinsics[n], scene.intrinsics * scale, rtol=1e-12)
            assert [actor.track for actor in request.actors[n]] == [actor.track for actor in scene.actors]
            for actor, other in zip(request.actors[n], scene.actors, strict=True):
                assert (actor.category, actor.size) == (other.category, tuple(other.size))
                np.testing.assert_array_equal(actor.global_from_box, other.global_from_box)
                words = actor.category.split(".")
                assert actor.class_name == ("pedestrian" if "pedestrian" in words else "cycle" if "bicycle" in words else "motor_vehicle")
    assert {len(request.t_us) for request in generator.requests[:-1]} == {3}
    assert generator.requests[0].maps["instance"].dtype == np.uint16 and generator.requests[0].maps["instance"].max() > 0
    assert np.isinf(generator.requests[0].maps["depth"]).any()


def test_earlier_images_are_kept_apart(log: pskel.Log, renderer: pskel.Renderer) -> None:
    class Same(Blend):
        image = np.zeros((6, 56, 100, 3), np.uint8)

        def generate(self, request: pskel.ImageRequest) -> Any:
            super().generate(request)
            self.image[:] = request.frame  # one array for all images
            return self.image

    generator = Same()
    for shown in images.Images(pskel.Simulation(log, ego="lane_change", warmup_frames=2, steps=12), renderer, generator, log):
        shown[:] = 255
    means = [[int(image.mean()) for image in request.images] for request in generator.requests]
    assert means[2:] == [[means[1][1], 2, 3], [2, 3, 4], [3, 4, 5]] and 255 not in means[0]


def test_what_the_images_of_one_process_need(log: pskel.Log, renderer: pskel.Renderer, skeleton: pskel.Skeleton) -> None:
    def run(simulation: pskel.Simulation, by: pskel.Renderer = renderer, **attributes: Any) -> None:
        generator = Blend()
        for name, value in attributes.items():
            setattr(generator, name, value)
        for _ in images.Images(simulation, by, generator, log):
            if simulation.needs_plan:
                simulation.act(ahead(None))

    expected = "expected warmup_frames of at least 4, the references of the generator, found a plan before frame"
    for ego in ("caller", "lane_change"):
        with pytest.raises(ValueError, match=expected):
            run(pskel.Simulation(log, ego=ego, warmup_frames=2, steps=20), references=4)
    run(pskel.Simulation(log, ego="lane_change", warmup_frames=4, steps=20), references=4)
    plain = pskel.Renderer(skeleton, out_size=(56, 100), maps=["color"])
    with pytest.raises(ValueError, match="which the generator wants, found none of depth, class, instance, boxes, map"):
        run(pskel.Simulation(log, warmup_frames=2, steps=12), plain)
    with pytest.raises(ValueError, match=r"expected images uint8 \[6, 56, 99, 3\] of the generator, found uint8 \[6, 56, 100, 3\]"):
        run(pskel.Simulation(log, warmup_frames=2, steps=12), image_size=(56, 99), references=0, history=0)
    with pytest.raises(ValueError, match="expected a simulation at its start, found one at step 1"):
        moved = pskel.Simulation(log, ego="replay")
        moved.step()
        run(moved)
    with pytest.raises(ValueError, match="expected a prompt or 6 captions, found 1"):
        images.Images(pskel.Simulation(log), renderer, Blend(), log, prompt=["rain"])
