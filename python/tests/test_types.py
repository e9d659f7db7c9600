"""The types of the package: strict for its examples, and equal to what the extension has."""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pskel
import pytest
from pskel import _types

ROOT = Path(__file__).parent.parent
PLAIN = ["examples/own_points.py", "examples/render_frame.py", "examples/drive.py"]
TORCH = ["examples/train.py", "examples/reset_and_roll.py"]
MODELS = ["pskel/models"]
METRICS = ["pskel/metrics"]
ALPASIM = ["pskel/alpasim", "pskel/egodriver", "pskel/serve"]
PLANNERS = ["pskel/nuplan_planner.py", "pskel/navsim_agent.py", "pskel/navsim_scenes.py", "pskel/drivearena", "pskel/hugsim.py"]
IMAGES = ["pskel/images", "pskel/_messages.py"]
RERUN = ["pskel/rerun.py"]
TRAIN = ["pskel/train", "tests/train"]
PARTS = [
    ("gymnasium", PLAIN),
    ("torch", TORCH),
    ("diffusers", MODELS),
    ("torchmetrics", METRICS),
    ("grpc", ALPASIM),
    ("numpy", PLANNERS),
    ("numpy", IMAGES),
    ("rerun", RERUN),
    ("accelerate", TRAIN),
]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """One cache for all runs of mypy: the types of large packages are read once."""
    return {**os.environ, "MYPY_CACHE_DIR": str(tmp_path_factory.mktemp("mypy"))}


@pytest.mark.parametrize(("extra", "examples"), PARTS)
def test_package_and_examples_are_typed(extra: str, examples: list[str], environment: dict[str, str]) -> None:
    pytest.importorskip("mypy")
    pytest.importorskip(extra)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", *examples],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


def test_stubs_describe_the_extension(environment: dict[str, str]) -> None:
    pytest.importorskip("mypy")
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "pskel._pskel"],
        cwd=ROOT / "tests", env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def test_functions_with_the_same_keyword_have_the_same_default_and_type() -> None:
    export, renderer = (inspect.signature(function).parameters for function in (pskel.export, pskel.Renderer))
    common = set(export) & set(renderer)
    assert {"maps", "splat", "radius", "augment_share", "rasterizer", "device"} <= common
    for name in common:
        assert (export[name].default, export[name].annotation) == (renderer[name].default, renderer[name].annotation), name
    for kind, parameters in ((_types.ExportKeywords, export), (_types.RenderKeywords, renderer)):
        for name, reference in kind.__annotations__.items():
            assert reference.__forward_arg__ == parameters[name].annotation, name
    own = {"logs", "out", "layout", "skeletons", "progress"}
    assert set(_types.ExportKeywords.__annotations__) == set(export) - own


def test_documented_names_are_those_of_the_library(skeleton: pskel.Skeleton, log: pskel.Log) -> None:
    calls = {
        pskel.Renderer: lambda **options: pskel.Renderer(skeleton, rasterizer="cpu", **options),
        pskel.Simulation: lambda **options: pskel.Simulation(log, **options),
        pskel.Log: lambda **options: pskel.Log(log.name, **options),
    }
    checked = 0
    for kind, call in calls.items():
        for name, documented in re.findall(r"^ *(\w+) : \{([^}]*)\}$", kind.__doc__ or "", re.MULTILINE):
            if name == "rasterizer":
                continue
            with pytest.raises(ValueError, match=rf"expected {name} to be one of .*, found \"nothing\"") as caught:
                call(**{name: "nothing"})
            names = re.findall(r"one of (.*), found", str(caught.value))[0]
            assert [word.strip('"') for word in documented.split(", ")] == names.split(", "), name
            checked += 1
    assert checked >= 12
