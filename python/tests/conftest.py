"""A small town and its skeleton, built once."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pskel
import pytest

pytest.register_assert_rewrite("mcap_files", "parity", "pas_base", "pas_frames", "image_base", "image_frames", "image_rollout")

# Files with the longest tests: processes that share the files end together if these begin first.
LONGEST = ["protocol", "image_drive", "pas_train_drive", "docs", "metrics", "train_render", "image_cost", "types"]

TOWN = "town:seed=7,frames=4,size=113x200"
DRIVE = "town:seed=7,frames=12,size=113x200"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    places = {f"test_{name}.py": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.name, len(places)))


@pytest.fixture(scope="session")
def log() -> pskel.Log:
    return pskel.Log(TOWN)


@pytest.fixture(scope="session")
def skeleton(log: pskel.Log, tmp_path_factory: pytest.TempPathFactory) -> pskel.Skeleton:
    return pskel.build(log, tmp_path_factory.mktemp("town") / "skeleton")


@pytest.fixture(scope="session")
def renderer(skeleton: pskel.Skeleton) -> pskel.Renderer:
    return pskel.Renderer(skeleton, out_size=(56, 100), maps=["color", "depth", "class", "instance", "boxes", "map"])


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the skeleton of DRIVE."""
    folder = tmp_path_factory.mktemp("drive")
    pskel.build(pskel.Log(DRIVE), folder / "skeleton")
    return folder


Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Runs a program in its own process; a program that does not end in a minute fails."""

    def run(*args: str, check: bool = True) -> "subprocess.CompletedProcess[str]":
        done = subprocess.run(
            [sys.executable, *args], capture_output=True, text=True, timeout=120, cwd=tmp_path, check=False
        )
        assert not check or done.returncode == 0, done.stderr
        return done

    return run
