"""Tokens of images, in tables of nuScenes and nuPlan that are written by hand."""

import json
import sqlite3
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")
from pskel.train import DataError  # noqa: E402
from pskel.train.data.tokens import location_of, scene_token, tokens_of  # noqa: E402


def write_nuscenes(root: Path, version: str = "v1.0-mini") -> None:
    """Two scenes; the samples and images of the second are in another order than their times."""
    tables: dict[str, list[dict[str, Any]]] = {
        "sensor": [{"token": "s0", "channel": "CAM_FRONT"}, {"token": "s1", "channel": "LIDAR_TOP"}],
        "calibrated_sensor": [{"token": "c0", "sensor_token": "s0"}, {"token": "c1", "sensor_token": "s1"}],
        "scene": [{"token": "n0", "name": "scene-1"}, {"token": "n1", "name": "scene-2"}],
        "sample": [
            {"token": "p2", "scene_token": "n1", "timestamp": 700},
            {"token": "p1", "scene_token": "n1", "timestamp": 200},
            {"token": "p0", "scene_token": "n0", "timestamp": 100},
        ],
        "sample_data": [
            {"token": "d0", "sample_token": "p0", "calibrated_sensor_token": "c0", "is_key_frame": True},
            {"token": "d2", "sample_token": "p2", "calibrated_sensor_token": "c0", "is_key_frame": True},
            {"token": "d1", "sample_token": "p1", "calibrated_sensor_token": "c0", "is_key_frame": True},
            {"token": "d9", "sample_token": "p1", "calibrated_sensor_token": "c0", "is_key_frame": False},
            {"token": "l1", "sample_token": "p1", "calibrated_sensor_token": "c1", "is_key_frame": True},
        ],
    }
    (root / version).mkdir(parents=True)
    for name, rows in tables.items():
        (root / version / f"{name}.json").write_text(json.dumps(rows))


def test_key_frames_of_nuscenes(tmp_path: Path) -> None:
    write_nuscenes(tmp_path)
    for text in (f"nuscenes:{tmp_path}#scene-2", f"{tmp_path}", f"nuscenes:{tmp_path}@v1.0-mini#scene-2"):
        found = tokens_of(text, "scene-2", [200, 700], ["CAM_FRONT"])
        assert [frame["CAM_FRONT"] for frame in found] == ["d1", "d2"]
    with pytest.raises(DataError, match="expected 3 key frames of scene-2, found 2"):
        tokens_of(f"nuscenes:{tmp_path}", "scene-2", [1, 2, 3], ["CAM_FRONT"])
    with pytest.raises(DataError, match="expected scene scene-3, found 2 others"):
        tokens_of(f"nuscenes:{tmp_path}", "scene-3", [1], ["CAM_FRONT"])
    write_nuscenes(tmp_path, "v1.0-test")
    with pytest.raises(DataError, match="expected a version after @, found several"):
        tokens_of(f"nuscenes:{tmp_path}", "scene-2", [200, 700], ["CAM_FRONT"])


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


def test_nearest_images_of_nuplan(tmp_path: Path) -> None:
    path = tmp_path / "log.db"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE camera (token BLOB, channel VARCHAR)")
        database.execute("CREATE TABLE image (token BLOB, camera_token BLOB, timestamp INTEGER)")
        database.execute("INSERT INTO camera VALUES (x'01', 'CAM_F0'), (x'02', 'CAM_L0')")
        # Images of 10 Hz, frames of 20 Hz: two frames share an image, a tie goes to the earlier one.
        rows = [(bytes([10 + i]), b"\x01", 100_000 * i) for i in range(3)] + [(b"\xab\xcd", b"\x02", 90_000)]
        database.executemany("INSERT INTO image VALUES (?, ?, ?)", rows)
        database.execute("CREATE TABLE log (location VARCHAR)")
        database.execute("INSERT INTO log VALUES ('us-ma-boston')")
    found = tokens_of(f"nuplan:{path}", "log", [0, 49_000, 50_000, 51_000, 200_000], ["CAM_F0", "CAM_L0"])
    assert [frame["CAM_F0"] for frame in found] == ["0a", "0a", "0a", "0b", "0c"]
    assert {frame["CAM_L0"] for frame in found} == {"abcd"}
    with pytest.raises(DataError, match="expected images of CAM_R0, found none"):
        tokens_of(f"nuplan:{path}", "log", [0], ["CAM_R0"])
    assert location_of(f"nuplan:{path}") == location_of(str(path)) == "us-ma-boston"
    assert location_of(f"nuscenes:{tmp_path}") == location_of("nuplan:/nowhere.db") == ""
    (tmp_path / "other.db").write_text("no database")
    with pytest.raises(DataError, match="expected a log of nuPlan"):
        tokens_of(f"nuplan:{tmp_path / 'other.db'}", "log", [0], ["CAM_F0"])
    with pytest.raises(DataError, match="expected a log of nuScenes or nuPlan for data.pas_cache, found av2:"):
        tokens_of("av2:/data", "log", [0], ["CAM_F0"])


def test_images_of_a_town() -> None:
    found = tokens_of("town:seed=7", "town-7", [0, 200_000], ["CAM_FRONT"])
    assert found == [{"CAM_FRONT": "000000_CAM_FRONT"}, {"CAM_FRONT": "000001_CAM_FRONT"}]
