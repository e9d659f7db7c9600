"""Captions in small files of every form, and logs whose tables are written by hand."""

import json
import sqlite3
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")
from pskel.train import DataError  # noqa: E402
from pskel.train.data.captions import captions_of, captions_of_log, read_captions  # noqa: E402
from test_train_tokens import write_nuscenes  # noqa: E402


def write(folder: Path, document: Any) -> Path:
    path = folder / "captions.json"
    path.write_text(json.dumps(document))
    return path


def test_captions_of_logs_frames_and_cameras(tmp_path: Path) -> None:
    captions = read_captions(write(tmp_path, {"a": "rain", "c": ["one", ["left", "right"]]}))
    for log, expected in (("a", ("rain",) * 2), ("c", ("left", "right")), ("e", ("", ""))):
        assert captions_of(captions_of_log(captions, "town:", log), log, 1, 0, ("L", "R")) == expected
    of_log = captions_of_log(captions, "town:", "c")
    assert captions_of(of_log, "c", 0, 0, ("L", "R")) == ("one", "one")
    assert captions_of(lambda log, frame, camera: f"{log} {frame} {camera}", "x", 3, 0, ("L",)) == ("x 3 L",)
    for frame, cameras, text in ((2, ("L", "R"), "found 2, none of frame 2"), (1, ("L",), "captions of 1 cameras")):
        with pytest.raises(ValueError, match=text):
            captions_of(of_log, "c", frame, 0, cameras)
    assert read_captions(None) == {}


def test_time_and_weather_of_nuplan(tmp_path: Path) -> None:
    """As the published networks for nuPlan were trained: the parts, then the location of the log."""
    path = tmp_path / "log.db"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE log (logfile VARCHAR, location VARCHAR)")
        database.execute("INSERT INTO log VALUES ('log', 'las_vegas')")
    document = {"log": {"time": "daytime", "weather": "clear"}, "b": {"weather": "rain", "time": None}, "d": {}}
    captions = read_captions(write(tmp_path, document))
    clip = "This is a nuplan video clip"
    for text, log, expected in (
        (f"nuplan:{path}", "log", f"daytime. clear. {clip} from las_vegas"),
        (str(path), "log", f"daytime. clear. {clip} from las_vegas"),
        ("town:seed=1", "b", f"rain. {clip}"),
        ("town:seed=1", "d", clip),
    ):
        assert captions_of_log(captions, text, log) == {log: expected}
    assert captions_of_log(captions, str(path), "other") == {}


def test_images_have_the_nearest_caption(tmp_path: Path) -> None:
    """Calculated by hand. Scene n1 of the tables is named scene-2."""
    write_nuscenes(tmp_path / "data")
    a = {"time": "day", "weather": "rain", "environment": "street", "objects": "cars", "image_description": "first"}
    document = {
        "n1|CAM_A|100": a,
        "n1|CAM_A|200": {**a, "image_description": "second"},
        "n1|CAM_B|110": {"time": "night", "weather": "rain", "environment": "", "image_description": "b"},
        "n1|CAM_C|90": {"time": "night", "weather": "sun", "objects": None, "image_description": "c"},
        "n0|CAM_A|150": {"time": "dusk"},
    }
    path = write(tmp_path, document)
    captions = read_captions(path)
    for text in (f"nuscenes:{tmp_path / 'data'}#scene-2", str(tmp_path / "data")):
        of_log = captions_of_log(captions, text, "scene-2")
        assert list(of_log) == ["scene-2"]

    def texts(t_us: int, *cameras: str) -> tuple[str, ...]:
        return captions_of(of_log, "scene-2", 0, t_us, cameras)

    three = "CAM_A", "CAM_B", "CAM_C"
    # Two of three cameras say night, two say rain.
    first = ("night. rain. street. cars. first", "night. rain. b", "night. rain. c")
    assert texts(149, *three) == texts(-1000, *three) == first
    assert texts(150, *three) == first  # a tie goes to the earlier one
    second = ("night. rain. street. cars. second", *first[1:])
    assert texts(151, *three) == texts(1000, *three) == second
    # Of two cameras each: the first one's.
    assert texts(0, "CAM_A", "CAM_C") == ("day. rain. street. cars. first", "day. rain. c")
    assert texts(0, "CAM_C", "CAM_A") == ("night. sun. c", "night. sun. street. cars. first")
    assert texts(0, "CAM_D", "CAM_B") == ("", "night. rain. b")  # a camera without captions
    with pytest.raises(ValueError, match="expected captions of CAM_X in scene-2, found those of CAM_A, CAM_B, CAM_C"):
        texts(0, "CAM_X")
    assert captions_of_log(captions, f"nuscenes:{tmp_path / 'data'}", "scene-1")["scene-1"] == {
        "CAM_A": {150: {"time": "dusk"}}
    }
    for text, log in ((f"nuscenes:{tmp_path / 'data'}", "scene-3"), ("town:seed=1", "town-1"), ("av2:/data", "log")):
        assert captions_of_log(captions, text, log) == {}
    # A name in place of a token is found too, and a caption of the log goes first.
    named = read_captions(write(tmp_path, {"town-1|CAM_A|5": {"time": "day"}, "n1|CAM_A|5": {}, "scene-2": "text"}))
    assert captions_of_log(named, "town:seed=1", "town-1") == {"town-1": {"CAM_A": {5: {"time": "day"}}}}
    assert captions_of_log(named, str(tmp_path / "data"), "scene-2") == {"scene-2": "text"}


@pytest.mark.parametrize(
    ("document", "found"),
    [
        ([], r"found \[\]: "),
        ({"a": 5}, "found 5 for 'a'"),
        ({"a": {"season": "fall"}}, "found {'season': 'fall'} for 'a'"),
        ({"a": {"time": 5}}, "found {'time': 5} for 'a'"),
        ({"a": {"time": "day", "objects": "cars"}}, "for 'a'"),
        ({"a": [1]}, r"found \[1\] for 'a'"),
        ({"a": [["x", 1]]}, "for 'a'"),
        ({"s|CAM_A|5": "text"}, r"found text for 's\|CAM_A\|5'"),
        ({"s|CAM_A|5": {"season": "fall"}}, "for 's"),
        ({"s|CAM_A|5": {"weather": ["sun"]}}, "for 's"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, document: Any, found: str) -> None:
    path = write(tmp_path, document)
    with pytest.raises(DataError, match=f"expected captions .*{found}") as caught:
        read_captions(path)
    assert str(caught.value).endswith(f": {path}") and "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="captions cannot be read: No such file or directory: .*none.json"):
        read_captions(tmp_path / "none.json")
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(DataError, match="expected captions as JSON, found another file: .*a.json"):
        read_captions(tmp_path / "a.json")
