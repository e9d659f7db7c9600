"""Bad input raises a clear exception: no crash, no hang."""

import pickle
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from conftest import TOWN, Run

EYE = np.eye(4)
K = [[100.0, 0.0, 50.0], [0.0, 100.0, 40.0], [0.0, 0.0, 1.0]]
POINT = [[0.0, 0.0, 5.0, 1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((3, 5)), r"expected points \[N, 6\] or \[N, 7\], found \[3, 5\]"),
        (np.zeros(6), r"expected points \[N, M\], found \[6\]"),
        ([[0, 0, np.nan, 0, 0, 0]], "expected finite positions"),
        ([[0, 0, 1, 0, 300, 0]], "expected 0 to 255 in column 4 of point 0, found 300"),
        ([[0, 0, 1, 0, 0, 0, -1]], "column 6 of point 0, found -1"),
    ],
)
def test_points_are_checked(points: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pskel.splat(points, [K], [EYE], (80, 100), rasterizer="cpu")  # type: ignore[arg-type]


def test_other_types_are_rejected() -> None:
    for points in ("points", [["a"] * 6], None, np.zeros((1, 6), complex), np.full((1, 6), None)):
        with pytest.raises(TypeError, match="expected an array of real numbers"):
            pskel.splat(points, [K], [EYE], (80, 100), rasterizer="cpu")  # type: ignore[arg-type]


def test_cameras_are_checked() -> None:
    singular = [[0.0, 0.0, 50.0], [0.0, 100.0, 40.0], [0.0, 0.0, 1.0]]
    turned = [[-100.0, 0.0, 50.0], [0.0, 100.0, 40.0], [0.0, 0.0, 1.0]]
    scaled = EYE * [2, 2, 2, 1]
    mirrored = EYE * [-1, 1, 1, 1]
    cases = [
        (([singular], [EYE], (80, 100)), "focal lengths above 0 and up to 1e9 pixels, found fx 0.*determinant"),
        (([turned], [EYE], (80, 100)), r"found fx -100\.0, fy 100\.0, determinant -10000\.0"),
        (([K, K], [EYE], (80, 100)), "camera_from_world for each of 2 intrinsics, found 1"),
        (([K], [EYE * np.nan], (80, 100)), r"rigid transform as camera_from_world\[0\]"),
        (([K], [scaled], (80, 100)), "rigid transform"),
        (([K], [mirrored], (80, 100)), "rigid transform"),
        (([K], [EYE], (0, 100)), r"expected a height and a width of 1 to 16384 pixels, found \(0, 100\)"),
        ((K, [EYE], (80, 100)), r"expected intrinsics \[N, 3, 3\], found \[3, 3\]"),
    ]
    for arguments, message in cases:
        with pytest.raises(ValueError, match=message):
            pskel.splat(POINT, *arguments, rasterizer="cpu")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="rasterizer"):
        pskel.splat(POINT, [K], [EYE], (80, 100), rasterizer="opengl")
    with pytest.raises(ValueError, match="splat schedule"):
        pskel.splat(POINT, [K], [EYE], (80, 100), schedule="5:1,4:2")


def test_scenes_are_checked(log: pskel.Log) -> None:
    camera = pskel.Camera("front", K, (80, 100), EYE)
    actor = pskel.Actor("a", "vehicle.car", (4.0, 2.0, 1.5), EYE)
    for call, message in [
        (lambda: log[0].move_ego(left_m=float("nan")), "expected a finite left_m, found NaN"),
        (lambda: pskel.Scene(EYE * np.nan, [camera]), "rigid transform as ego"),
        (lambda: pskel.Scene(np.eye(3), [camera]), r"expected ego \[4, 4\], found \[3, 3\]"),
        (lambda: pskel.Scene(EYE, [camera, camera]), "cameras once each"),
        (lambda: pskel.Scene(EYE, [camera], [actor, actor]), "tracks once each"),
        (lambda: pskel.Scene(EYE, [camera], name="../up"), "name"),
        (lambda: pskel.Camera("a/b", K, (80, 100), EYE), "name"),
        (lambda: pskel.Camera("front", np.zeros((3, 3)), (80, 100), EYE), "0 0 1|last row|focal"),
        (lambda: pskel.Actor("a", "vehicle.car", (4.0, 0.0, 1.5), EYE), "size|box"),
    ]:
        with pytest.raises(ValueError, match=message):
            call()


def test_options_of_the_renderer_are_checked(skeleton: pskel.Skeleton) -> None:
    for options, message in [
        ({"maps": ["colour"]}, "colour"),
        ({"splat": "1"}, "splat schedule"),
        ({"rasterizer": "opengl"}, "opengl"),
        ({"radius": -1.0}, "radius above 0"),
        ({"maps": "color"}, "sequence of map names, found 'color'"),
        ({"maps": []}, r"sequence of map names, found \[\]"),
        ({"maps": ["color,depth"]}, r"sequence of map names, found \['color,depth'\]"),
        ({"maps": ["points"]}, "expected the map tensor, of which points is a part"),
        ({"log": "other"}, "expected a log of the skeleton"),
    ]:
        with pytest.raises(ValueError, match=message):
            pskel.Renderer(skeleton, **options)  # type: ignore[arg-type]
    with pytest.raises(pskel.RenderError, match="no such device"):
        pskel.Renderer(skeleton, device="no such device")


def uses_of_a_size(log: pskel.Log, skeleton: pskel.Skeleton, size: Any) -> list[Callable[[], Any]]:
    return [
        lambda: log.images(log[0], size)[..., 0].shape,
        lambda: pskel.splat(POINT, [K], [EYE], size, rasterizer="cpu")["depth"].shape,
        lambda: pskel.Renderer(skeleton, size=size, maps=["depth"], rasterizer="cpu").render(log[0])["depth"].shape,
        lambda: pskel.Renderer(skeleton, out_size=size, maps=["depth"], rasterizer="cpu").render(log[0])["depth"].shape,
        lambda: pskel.Scene(EYE, [pskel.Camera("front", K, size, EYE)]).sizes,
    ]


@pytest.mark.parametrize("size", [(7, 12), [7, 12], np.array([7, 12]), (np.int64(7), np.uint8(12))])
def test_any_two_integers_are_a_size(log: pskel.Log, skeleton: pskel.Skeleton, size: object) -> None:
    found = [call() for call in uses_of_a_size(log, skeleton, size)]
    assert found == [(6, 7, 12), (1, 7, 12), (6, 7, 12), (6, 7, 12), [(7, 12)]]


@pytest.mark.parametrize(
    ("size", "exception"),
    [
        *[(size, ValueError) for size in [(0, 12), (7, -1), (7, 16385), (7, 2**70), (7,), (7, 12, 3)]],
        *[(size, TypeError) for size in [(7.0, 12.0), "7x12", 7, {7, 12}]],
    ],
)
def test_other_sizes_are_rejected(
    log: pskel.Log, skeleton: pskel.Skeleton, size: object, exception: type[Exception]
) -> None:
    for call in uses_of_a_size(log, skeleton, size):
        with pytest.raises(exception, match="expected a height and a width of 1 to 16384 pixels, found"):
            call()


def test_missing_and_damaged_files_are_named(tmp_path: Path, log: pskel.Log) -> None:
    with pytest.raises(pskel.LogError, match="expected"):
        pskel.Log("village:1")
    with pytest.raises(pskel.LogError, match=str(tmp_path)):
        pskel.Log(f"nuscenes:{tmp_path}")
    with pytest.raises(pskel.BuildError, match=str(tmp_path)):
        pskel.Skeleton(tmp_path)
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(pskel.BuildError, match=str(tmp_path)):
        pskel.build(log, tmp_path)
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert issubclass(pskel.LogError, pskel.Error)


def test_a_closed_renderer_says_so(log: pskel.Log, skeleton: pskel.Skeleton) -> None:
    renderer = pskel.Renderer(skeleton, rasterizer="cpu", out_size=(28, 50))
    renderer.close()
    renderer.close()
    for call in (lambda: renderer.render(log[0]), lambda: renderer.render_all([log[0]]), lambda: renderer.device):
        with pytest.raises(RuntimeError, match="expected an open Renderer, found a closed one"):
            call()
    with pytest.raises(RuntimeError, match="found a closed one"), renderer:
        pass
    renderer = pskel.Renderer(skeleton, rasterizer="cpu", out_size=[28, 50])
    frames = renderer.render_all([log[0], log[1]])
    next(frames)
    renderer.close()
    with pytest.raises(RuntimeError, match="found a closed one"):
        next(frames)


def test_scenes_of_another_log_are_rejected(renderer: pskel.Renderer) -> None:
    other = pskel.Log("town:seed=8,frames=2,size=113x200")
    for call in (lambda: renderer.render(other[0]), lambda: list(renderer.render_all([other[0].move_ego(left_m=1.0)]))):
        with pytest.raises(ValueError, match="expected a scene of log town-7-4f-overcast, found one of town-8-2f"):
            call()
    log = pskel.Log(TOWN)
    with pytest.raises(ValueError, match="expected a scene of log town-7-4f-overcast, found one of town-8-2f"):
        log.images(other[0], (28, 50))
    with pytest.raises(ValueError, match=r"expected a time of the log, \d+ to \d+ us, found 5"):
        log.at(5)
    with pytest.raises(ValueError, match="expected a state that Simulation.save returned, found another text: missing field"):
        pskel.Simulation(log, saved="{}")


def test_two_threads_share_a_renderer(log: pskel.Log, renderer: pskel.Renderer) -> None:
    expected = [renderer.render(log[i])["color"] for i in range(4)]
    failed: list[int] = []

    def draw(index: int) -> None:
        for _ in range(20):
            if (renderer.render(log[index])["color"] != expected[index]).any():
                failed.append(index)

    threads = [threading.Thread(target=draw, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()
    assert not failed


def test_other_threads_run_during_a_call(log: pskel.Log, skeleton: pskel.Skeleton) -> None:
    renderer = pskel.Renderer(skeleton, size=(900, 1600), maps=["color"])
    count = 0
    done = threading.Event()

    def work() -> None:
        nonlocal count
        while not done.is_set():
            count += 1
            time.sleep(0.001)

    thread = threading.Thread(target=work)
    thread.start()
    renderer.render(log[0])
    before = count
    for _ in range(5):
        renderer.render(log[0])
    during = count - before
    done.set()
    thread.join()
    assert during > 10


FORK = """
import os, sys, time
import pskel
log = pskel.Log({town!r})
skeleton = pskel.Skeleton({skeleton!r})
{before}
child = os.fork()
if child == 0:
    try:
        {inside}
        os._exit(7)
    except pskel.Error as error:
        print(type(error).__name__, error, flush=True)
        os._exit(3)
deadline = time.monotonic() + 60
while time.monotonic() < deadline:
    pid, status = os.waitpid(child, os.WNOHANG)
    if pid:
        print("exit", os.waitstatus_to_exitcode(status))
        break
    time.sleep(0.05)
else:
    os.kill(child, 9)
    print("hangs")
"""


IMAGES = "log.images(log[0], (28, 50))"
BUILD = "pskel.build(log, 'built', frames=(0, 1))"


@pytest.mark.parametrize(
    ("before", "inside", "expected"),
    [
        ("renderer = pskel.Renderer(skeleton)", "renderer.render(log[0])", "RenderError .* open a Renderer in each process"),
        ("renderer = pskel.Renderer(skeleton)", "pskel.Renderer(skeleton)", "RenderError .* by spawning instead of forking"),
        ("pskel.Renderer(skeleton, rasterizer='cpu').render(log[0])", "pskel.Renderer(skeleton).render(log[0])", "exit 7"),
        ("", "pskel.Renderer(skeleton).render(log[0])", "exit 7"),
        (IMAGES, IMAGES, "RenderError .* open the Log in each process"),
        (IMAGES, "del log", "exit 7"),
        (f"s = pskel.Simulation(log, ego='replay'); {IMAGES}; del log", "s.step(); del s", "exit 7"),
        (IMAGES, f"log = pskel.Log({TOWN!r}); {IMAGES}", "RenderError .* by spawning instead of forking"),
        (IMAGES, BUILD, "RenderError .* open the Log in each process"),
        (BUILD, BUILD, "RenderError .* open the Log in each process"),
        (BUILD, "del log", "exit 7"),
        ("renderer = pskel.Renderer(skeleton)", BUILD, "BuildError .* by spawning instead of forking"),
        ("", IMAGES, "exit 7"),
    ],
)
def test_forks_do_not_hang(skeleton: pskel.Skeleton, run: Run, before: str, inside: str, expected: str) -> None:
    done = run("-c", FORK.format(town=TOWN, skeleton=str(skeleton.path), before=before, inside=inside))
    assert re.search(expected, done.stdout, re.DOTALL), done.stdout + done.stderr


def test_forks_read_recorded_images(tmp_path: Path, run: Run, skeleton: pskel.Skeleton) -> None:
    folder = str(tmp_path / "town")
    run("-m", "pskel", "town", "seed=7,frames=2,size=113x200", "--out", folder)
    before = f"{IMAGES}; renderer = pskel.Renderer(skeleton)"
    log = f"nuscenes:{folder}"
    done = run("-c", FORK.format(town=log, skeleton=str(skeleton.path), before=before, inside=f"{IMAGES}; del log"))
    assert "exit 7" in done.stdout, done.stdout + done.stderr
    (image, *_) = [path for path in pskel.Log(log).files if path.suffix == ".jpg"]
    image.write_bytes(b"damaged")
    recorded = pskel.Log(log)
    with pytest.raises(pskel.LogError, match=image.name):
        for scene in (recorded[0], recorded[1]):
            recorded.images(scene, (28, 50))


def test_logs_and_skeletons_pickle(log: pskel.Log, skeleton: pskel.Skeleton) -> None:
    again = pickle.loads(pickle.dumps((log, skeleton)))
    assert again[0].times_us == log.times_us and again[1].path == skeleton.path
    with pytest.raises(TypeError, match="pickle"):
        pickle.dumps(pskel.Renderer(skeleton, rasterizer="cpu"))


def test_an_interrupt_stops_a_build_which_then_resumes(tmp_path: Path, log: pskel.Log, run: Run) -> None:
    program = f"""
import pskel, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in background jobs
class Progress:
    def start(self, stage, steps): print(stage, steps, flush=True)
    def step(self): print("step", flush=True)
try:
    pskel.build(pskel.Log("{TOWN.replace("frames=4,size=113x200", "frames=20,size=28x50")}"), {str(tmp_path / "out")!r}, progress=Progress())
except KeyboardInterrupt:
    print("interrupted")
    sys.exit(5)
"""
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if line == "step\n":
            process.send_signal(signal.SIGINT)
            break
    rest = process.stdout.read()
    assert process.wait(60) == 5 and rest.endswith("interrupted\n")
    assert not (tmp_path / "out" / "skeleton.json").exists()


def test_an_exception_of_the_progress_object_stops_the_build(tmp_path: Path, log: pskel.Log) -> None:
    class Progress:
        steps = 0

        def start(self, stage: str, steps: int, /) -> None:
            pass

        def step(self) -> None:
            self.steps += 1
            raise KeyError("mine")

    progress = Progress()
    with pytest.raises(KeyError, match="mine"):
        pskel.build(log, tmp_path / "out", progress=progress)
    assert progress.steps == 1


def test_the_command_exits_with_its_code(run: Run) -> None:
    assert run("-m", "pskel", "--version").stdout.startswith("pskel ")
    wrong = run("-m", "pskel", "rendr", check=False)
    assert wrong.returncode == 2 and "rendr" in wrong.stderr
    missing = run("-m", "pskel", "info", "nuscenes:/nowhere", check=False)
    assert missing.returncode == 1 and "/nowhere" in missing.stderr
