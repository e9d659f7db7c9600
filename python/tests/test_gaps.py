"""Logs with missing and damaged parts: one policy."""

import pickle
import warnings
from pathlib import Path

import pskel
import pytest
from conftest import Run


@pytest.fixture
def incomplete(tmp_path: Path, run: Run) -> str:
    """A log without one of its images, and with a damaged HD map."""
    run("-m", "pskel", "town", "seed=7,frames=2,size=57x100", "--out", "data")
    next((tmp_path / "data/samples/CAM_BACK").iterdir()).unlink()
    next((tmp_path / "data/maps/expansion").iterdir()).write_text("{}")
    return f"nuscenes:{tmp_path / 'data'}"


def test_gaps_are_skipped_and_named(incomplete: str, tmp_path: Path) -> None:
    with pytest.warns(UserWarning) as caught:
        log = pskel.Log(incomplete)
    texts = " ".join(str(warning.message) for warning in caught)
    assert "1 gaps" in texts and "CAM_BACK" in texts and "HD map that cannot be read" in texts
    assert log.notes["missing image files"] == 1
    assert len(log.gaps) == 1 and "CAM_BACK" in log.gaps[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert pickle.loads(pickle.dumps(log)).gaps == log.gaps
    skeleton = pskel.build(log, tmp_path / "skeleton")
    maps = pskel.Renderer(skeleton, out_size=(28, 50), maps=["depth"]).render(log[0])
    assert maps["depth"].shape[1:] == (28, 50)
    with pytest.raises(ValueError, match="HD map"):
        pskel.Renderer(skeleton, out_size=(28, 50), maps=["map"]).render(log[0])


def test_gaps_can_be_errors(incomplete: str) -> None:
    with pytest.raises(pskel.LogError, match="missing image files: .*CAM_BACK"):
        pskel.Log(incomplete, missing="error")
    with pytest.raises(ValueError, match='missing to be one of skip, error, found "ignore"'):
        pskel.Log(incomplete, missing="ignore")
