"""The types of the package: strict for its examples, and equal to what the extension has."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ENVIRONMENT = {**os.environ, "MYPY_CACHE_DIR": os.devnull}
PLAIN = ["examples/own_points.py", "examples/render_frame.py", "examples/drive.py"]
TORCH = ["examples/train.py", "examples/reset_and_roll.py"]
MODELS = ["pskel/models"]
METRICS = ["pskel/metrics"]
ALPASIM = ["pskel/alpasim", "pskel/egodriver", "pskel/serve"]
PLANNERS = ["pskel/nuplan_planner.py", "pskel/navsim_agent.py", "pskel/navsim_scenes.py"]
RERUN = ["pskel/rerun.py"]
PARTS = [
    ("gymnasium", PLAIN),
    ("torch", TORCH),
    ("diffusers", MODELS),
    ("torchmetrics", METRICS),
    ("grpc", ALPASIM),
    ("numpy", PLANNERS),
    ("rerun", RERUN),
]


@pytest.mark.parametrize(("extra", "examples"), PARTS)
def test_package_and_examples_are_typed(extra: str, examples: list[str]) -> None:
    pytest.importorskip("mypy")
    pytest.importorskip(extra)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", *examples],
        cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


def test_stubs_describe_the_extension() -> None:
    pytest.importorskip("mypy")
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "pskel._pskel"],
        cwd=ROOT / "tests", env=ENVIRONMENT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
