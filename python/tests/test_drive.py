"""The live page from Python."""

import urllib.error
import urllib.request
from pathlib import Path

import pytest

import pskel

TOWN = "town:seed=7,frames=2,size=45x80"


def test_a_page_runs_until_it_is_closed(tmp_path: Path) -> None:
    log = pskel.Log(TOWN)
    assert log.arguments == [TOWN]
    with pskel.drive(log, tmp_path / "skeleton", out=tmp_path / "out", port=0) as page:
        with urllib.request.urlopen(page.url, timeout=60) as answer:
            assert b"<!doctype html>" in answer.read(200).lower()
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(page.url.split("?")[0], timeout=60)
        assert page.url in page._repr_html_() and "running" in repr(page)
    assert "ended" in repr(page)
    page.close()


def test_a_page_that_cannot_be_served_is_an_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(pskel.Error, match="exit code 2"):
        pskel.drive("town:seed=x", out=tmp_path / "out")
    assert "seed" in capfd.readouterr().err
    with pytest.raises(pskel.Error, match="exit code 2"):
        pskel.drive(TOWN, out=tmp_path / "out", generate_hz=5.0)
    assert "expected --generator with --generate-hz" in capfd.readouterr().err


def test_the_options_of_a_log_are_passed_on(tmp_path: Path) -> None:
    log = pskel.Log(TOWN, missing="error", ring_is="beam")
    assert log.arguments == [TOWN, "--missing", "error", "--ring-is", "beam"]
