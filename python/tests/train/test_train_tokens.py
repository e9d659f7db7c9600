"""Tokens of scenes and locations, in tables of nuScenes and nuPlan that are written by hand."""

import json
import sqlite3
from pathlib import Path

import pytest

pytest.importorskip("torch")
from pskel.train import DataError  # noqa: E402
from pskel.train.data.tokens import location_of, scene_token  # noqa: E402


def write_nuscenes(root: Path, version: str = "v1.0-mini") -> None:
    """Two scenes."""
    (root / version).mkdir(parents=True)
    rows = [{"token": "n0", "name": "scene-1"}, {"token": "n1", "name": "scene-2"}]
    (root / version / "scene.json").write_text(json.dumps(rows))


def test_tokens_of_scenes(tmp_path: Path) -> None:
    write_nuscenes(tmp_path)
    assert scene_token(f"nuscenes:{tmp_path}@v1.0-mini#scene-2", "scene-2") == "n1"
    assert scene_token(str(tmp_path), "scene-1") == "n0" and scene_token(str(tmp_path), "scene-3") is None
    (tmp_path / "av2").mkdir()
    for text in (str(tmp_path / "av2"), f"av2:{tmp_path}", "town:seed=1", f"nuplan:{tmp_path / 'log.db'}"):
        assert scene_token(text, "scene-1") is None
    write_nuscenes(tmp_path, "v1.0-test")
    with pytest.raises(DataError, match="expected a version after @, found several"):
        scene_token(str(tmp_path), "scene-1")
    (tmp_path / "v1.0-test" / "scene.json").write_text('[{"token": "t"}]')
    with pytest.raises(DataError, match="expected tables of nuScenes, found one without 'name'"):
        scene_token(f"{tmp_path}@v1.0-test", "scene-1")


def test_locations_of_nuplan(tmp_path: Path) -> None:
    path = tmp_path / "log.db"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE log (location VARCHAR)")
        database.execute("INSERT INTO log VALUES ('us-ma-boston')")
    assert location_of(f"nuplan:{path}") == location_of(str(path)) == "us-ma-boston"
    assert location_of(f"nuscenes:{tmp_path}") == location_of("nuplan:/nowhere.db") == ""
    (tmp_path / "other.db").write_text("no database")
    with pytest.raises(DataError, match="expected a log of nuPlan"):
        location_of(f"nuplan:{tmp_path / 'other.db'}")
