"""Captions of files by log, image, and scene, camera and time, for the frames and cameras of logs."""

import json
import os
from pathlib import Path
from typing import Any

import pskel
import pytest

SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[3] / "shared"))
PANDASET = SHARED / "data/pandaset-002"
needs_pandaset = pytest.mark.skipif(not PANDASET.exists(), reason="pandaset-002 is not there (set PSKEL_SHARED)")


def captions(folder: Path, document: Any) -> pskel.Captions:
    path = folder / "captions.json"
    path.write_text(json.dumps(document))
    return pskel.Captions(path)


def test_a_log_has_a_text_for_all_cameras(tmp_path: Path) -> None:
    log = pskel.Log("town:seed=7,frames=3,size=113x200")
    document = {log.name: {"weather": "rain", "time": None}, "other": "Sun"}
    assert captions(tmp_path, document).of(log) == [["rain. This is a nuplan video clip from town"] * 6] * 3
    assert captions(tmp_path, {log.name: "Sun"}).of(log) == [["Sun"] * 6] * 3
    assert captions(tmp_path, {"other": "Sun"}).of(log) is None


@needs_pandaset
def test_images_have_the_nearest_caption(tmp_path: Path) -> None:
    """Calculated by hand: two of three cameras say night, and the second caption of a camera begins with frame 5."""
    log = pskel.Log(f"nuscenes:{PANDASET / 'nuscenes'}")
    names = log[0].cameras
    first, second, third = names[:3]
    t_us = [log.times_us[frame] for frame in (0, 10)]
    document = {
        f"{log.token}|{first}|{t_us[0]}": {"time": "day", "weather": "rain", "image_description": "first"},
        f"{log.token}|{first}|{t_us[1]}": {"time": "day", "weather": "rain", "image_description": "second"},
        f"{log.token}|{second}|{t_us[0]}": {"time": "night", "weather": "rain", "environment": "", "objects": "cars"},
        f"{log.token}|{third}|{t_us[0]}": {"time": "night", "weather": "sun", "objects": None},
        f"other|{first}|{t_us[0]}": {"time": "dusk"},
    }
    found = captions(tmp_path, document).of(log)
    assert found is not None and len(found) == len(log)
    expected = ["night. rain. cars", "night. rain"] + [""] * (len(names) - 3)
    assert found[:5] == [["night. rain. first", *expected]] * 5
    assert found[6:] == [["night. rain. second", *expected]] * (len(log) - 6)
    named = captions(tmp_path, {log.image_tokens[2][second]: "Rain", log.name: "Sun"}).of(log)
    assert named == [["Sun"] * len(names)] * 2 + [["Rain"] * len(names)] + [["Sun"] * len(names)] * (len(log) - 3)


@needs_pandaset
def test_time_and_weather_come_before_the_location(tmp_path: Path) -> None:
    """As the published networks for nuPlan were trained."""
    log = pskel.Log(f"nuplan:{next((PANDASET / 'nuplan').rglob('*.db'))}")
    found = captions(tmp_path, {log.name: {"time": "daytime", "weather": "clear"}}).of(log)
    text = "daytime. clear. This is a nuplan video clip from us-ca-pandaset-002"
    assert log.location == "us-ca-pandaset-002" and found == [[text] * len(log[0].cameras)] * len(log)


@pytest.mark.parametrize(
    ("document", "found"),
    [
        ([], "found an array"),
        ({"a": 5}, 'found 5 for "a"'),
        ({"a": {"season": "fall"}}, 'found a field "season" for "a"'),
        ({"a": ["one", "two"]}, 'for "a"'),
        ({"s|CAM_A|5": "text"}, 'found "text" for "s|CAM_A|5"'),
        ({"s|CAM_A|5": {"weather": ["sun"]}}, 'for "s|CAM_A|5"'),
    ],
)
def test_other_files_are_refused(tmp_path: Path, document: Any, found: str) -> None:
    with pytest.raises(pskel.Error) as caught:
        captions(tmp_path, document)
    text = str(caught.value)
    assert found in text and text.endswith(f": {tmp_path / 'captions.json'}") and "\n" not in text


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(pskel.Error, match="none.json"):
        pskel.Captions(tmp_path / "none.json")
