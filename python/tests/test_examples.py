"""The examples run, and their results are plausible."""

import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import DRIVE, TOWN, Run

sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))

EXAMPLES = Path(__file__).parent.parent / "examples"


def test_a_frame_is_plotted(tmp_path: Path, run: Run) -> None:
    image = pytest.importorskip("matplotlib.image")
    run("-m", "pskel", "town", "seed=7,frames=2,size=113x200", "--out", str(tmp_path / "town"))
    run(str(EXAMPLES / "render_frame.py"), f"nuscenes:{tmp_path / 'town'}", str(tmp_path / "out"))
    pixels = image.imread(tmp_path / "out" / "frame.png")
    assert pixels.shape[:2] == (360, 1600) and pixels.std() > 0.1


def test_own_points_are_rendered(tmp_path: Path) -> None:
    import own_points

    maps = own_points.main(tmp_path)
    assert (maps["instance"] == 1).sum() > 1000
    assert np.isfinite(maps["depth"]).mean() > 0.3


def test_a_network_learns(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    import train

    losses = train.main(TOWN, tmp_path, epochs=3, workers=0)
    assert losses[-1] < 0.7 * losses[0]


def test_a_policy_drives(drive: Path) -> None:
    pytest.importorskip("gymnasium")
    import drive as example

    assert example.main(DRIVE, drive, steps=10) > 0.5


def test_frames_are_generated(drive: Path) -> None:
    pytest.importorskip("torch")
    import reset_and_roll

    made = reset_and_roll.main(DRIVE, drive)
    assert len(made) == 3 and all(np.isfinite(frame).all() for frame in made)
