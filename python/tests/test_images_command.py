"""Image generators in closed loop: by the command, in the same process, and for the states of another simulation."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest

Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")

LOG = "town:seed=7,frames=4,size=45x80"
SIZE = (45, 80)
EXAMPLE = Path(__file__).parents[2] / "examples" / "images.py"
PER_PLAN, STEPS, REFERENCES = 2, 24, 3
Images = list[np.ndarray[Any, Any]]


@pytest.fixture(scope="module")
def skeleton(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("skeleton") / "sk"
    pskel.build(pskel.Log(LOG), folder)
    return folder


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recipe") / "recipe.json"
    path.write_text(json.dumps({"drawn": "45x80", "size": "45x80"}))
    return path


def command(skeleton: Path, recipe: Path, out: Path, generator: str, *more: str) -> list[str]:
    loop = ["--steps", str(STEPS), "--ego", "lane_change", "--actors", "idm", "--sim-hz", "10", "--plan-hz", "5"]
    maps = ["--maps", "color", "--size", "45x80", "--generator", generator, "--recipe", str(recipe)]
    return [sys.executable, "-m", "pskel", "simulate", LOG, "--skeleton", str(skeleton), "--out", str(out), *loop, *maps, *more]


def images_of(out: Path) -> dict[str, bytes]:
    """Bytes of all generated images."""
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.glob("steps/*/generated/*.png"))}


@pytest.fixture(scope="module")
def filled(skeleton: Path, recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fill") / "out"
    subprocess.run(command(skeleton, recipe, out, "fill"), check=True)
    return out


def example() -> str:
    return f"images:{sys.executable} {EXAMPLE}"


def test_the_example_is_fill_killed_and_resumed(skeleton: Path, recipe: Path, filled: Path, tmp_path: Path) -> None:
    expected = images_of(filled)
    assert len(expected) == 6 * (STEPS // PER_PLAN + 1)
    out = tmp_path / "out"
    program = subprocess.Popen(command(skeleton, recipe, out, example()), stderr=subprocess.PIPE)
    while not (out / "steps" / "000011").exists():
        assert program.poll() is None, program.communicate()[1]
        time.sleep(0.05)
    program.send_signal(signal.SIGKILL)
    program.communicate()
    assert len(images_of(out)) < len(expected)
    done = subprocess.run(command(skeleton, recipe, out, example(), "--resume"), check=True, capture_output=True, text=True)
    assert "of the pixels are holes" in done.stderr
    assert images_of(out) == expected
    record = json.loads((out / "rollout.json").read_text())["generator"]
    assert (record["references"], record["maps"], record["process"]) == (REFERENCES, ["color"], example())


def test_errors_of_a_generator_end_the_rollout(skeleton: Path, recipe: Path, tmp_path: Path) -> None:
    program = tmp_path / "wrong.py"
    program.write_text(
        "from pskel import images\n"
        "class Wrong(images.ImageGenerator):\n"
        "    image_size = (45, 80)\n"
        "    def generate(self, request):\n"
        "        raise MemoryError('no memory')\n"
        "images.serve(lambda hello: Wrong())\n"
    )
    done = subprocess.run(
        command(skeleton, recipe, tmp_path / "out", f"images:{sys.executable} {program}"), capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert 'expected images from the image generator, found the error "MemoryError: no memory"' in done.stderr
    for wrong in (["--window", "4"], ["--strategy", "rolling"], ["--guidance", "2"]):
        done = subprocess.run(command(skeleton, recipe, tmp_path / "no", example(), *wrong), capture_output=True, text=True, check=False)
        assert done.returncode == 2 and "expected --generator network, fill or process:.." in done.stderr, done.stderr


def pictures(out: Path) -> Iterator[np.ndarray[Any, Any]]:
    """Generated images ``[V, h, w, 3]`` of each planning step, in the order of the log's cameras."""
    cameras = pskel.Log(LOG)[0].cameras
    for step in range(0, STEPS + 1, PER_PLAN):
        folder = out / "steps" / f"{step:06}" / "generated"
        yield np.stack([np.asarray(Image.open(folder / f"{camera}.png")) for camera in cameras])


class Fill(pskel.ImageGenerator):
    image_size = SIZE
    references = REFERENCES

    def generate(self, request: pskel.ImageRequest) -> np.ndarray[Any, np.dtype[np.uint8]]:
        color = request.maps["color"][0]
        return pskel.fill_holes(color, np.where(color.any(axis=-1), 1, np.inf).astype(np.float32))


def simulation(log: pskel.Log) -> pskel.Simulation:
    return pskel.Simulation(log, ego="lane_change", actors="idm", steps=STEPS, sim_hz=10, plan_hz=5, warmup_frames=REFERENCES + 1)


OPTIONS = {"size": SIZE, "out_size": SIZE, "splat": "15:1,100:0", "color_filter": "visible-area", "rasterizer": "cpu"}


def test_the_same_in_the_same_process(skeleton: Path, filled: Path) -> None:
    log = pskel.Log(LOG)
    renderer = pskel.Renderer(pskel.Skeleton(skeleton), maps=["color"], log=log.name, **OPTIONS)
    made = list(pskel.images.Images(simulation(log), renderer, Fill(), log))
    for found, expected in zip(made, pictures(filled), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", ["fill", "images"])
def test_the_same_for_the_states_of_another_simulation(skeleton: Path, recipe: Path, filled: Path, name: str) -> None:
    log = pskel.Log(LOG)
    renderer = pskel.Renderer(pskel.Skeleton(skeleton), maps=["color"], log=log.name, rasterizer="cpu")
    text = "fill" if name == "fill" else example()
    generator = pskel.Generator(text, log[0], fps=5, log=log.name, recipe=recipe)
    assert (generator.references, generator.image_size) == (REFERENCES, SIZE)
    states, frame = simulation(log), 0
    for expected in pictures(filled):
        scene = states.scene
        # A scene of another program has no log, and the HD map of one.
        cameras = [scene.camera(camera) for camera in scene.cameras]
        own = pskel.Scene(scene.ego, cameras, scene.actors, t_us=scene.t_us, map_of=log[0])
        if frame < REFERENCES:
            generator.add_reference(renderer, own, expected)
        else:
            forecasts = [forecast.value for forecast in states.forecast(generator.forecasts)]
            np.testing.assert_array_equal(generator.step(renderer, own, forecasts), expected)
        frame += 1
        for _ in range(PER_PLAN):
            states.step()
    with pytest.raises(ValueError, match="expected a state after"):
        generator.step(renderer, log[0], [])
    generator.close()
    with pytest.raises(RuntimeError, match="found a closed one"):
        generator.step(renderer, log[0], [])


def test_a_generator_needs_its_references(skeleton: Path, recipe: Path) -> None:
    log = pskel.Log(LOG)
    renderer = pskel.Renderer(pskel.Skeleton(skeleton), maps=["color"], log=log.name, rasterizer="cpu")
    generator = pskel.Generator("fill", log[0], fps=5, recipe=recipe)
    with pytest.raises(pskel.Error, match="expected given references before the first generated frame, found none"):
        generator.step(renderer, log[0], [])
    generator = pskel.Generator("fill", log[0], fps=5, recipe=recipe, window=2)
    images = np.zeros((6, *SIZE, 3), np.uint8)
    with pytest.raises(ValueError, match=r"expected images \[6, 45, 80, 3\], found \[5, 45, 80, 3\]"):
        generator.add_reference(renderer, log[0], images[1:])
    generator.add_reference(renderer, log[0], images)
    with pytest.raises(pskel.Error, match="expected 1 references, found another one"):
        generator.add_reference(renderer, log[1], images)
    for wrong in ("sora", "network:"):
        with pytest.raises(ValueError, match="expected network, network:FILE, fill, process:COMMAND"):
            pskel.Generator(wrong, log[0], fps=5)
    with pytest.raises(pskel.Error, match=os.fspath(skeleton / "none")):
        pskel.Generator(f"network:{skeleton / 'none'}", log[0], fps=5)
