"""`pskel simulate --mcap`: its file in the readers of `mcap` and of Rerun, compared with the folder of the rollout."""

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DRIVE, Run
from mcap_files import matrix, read, vector

STEPS = 8
MAPS = ["color", "depth", "boxes"]
CAMERAS = ["CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT"]


@pytest.fixture
def rollout(drive: Path, tmp_path: Path, run: Run) -> Path:
    """The folder of a rollout, with its MCAP file beside it."""
    pytest.importorskip("mcap")
    given = ["simulate", DRIVE, f"--skeleton={drive / 'skeleton'}", f"--out={tmp_path / 'out'}", f"--steps={STEPS}"]
    maps = [f"--maps={','.join(MAPS)}", "--out-size=56x100", "--generator=fill"]
    run("-m", "pskel", *given, *maps, "--ego=lane_change", f"--mcap={tmp_path / 'a.mcap'}")
    return tmp_path / "out"


def rows_of(rollout: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (rollout / "states.jsonl").read_text().splitlines()]


def images_of(rollout: Path, step: int) -> dict[str, bytes]:
    """The PNG files of a step, by their topics."""
    folder = rollout / "steps" / f"{step:06}"
    maps = {f"/camera/{camera}/{kind}": folder / camera / f"{kind}.png" for camera in CAMERAS for kind in MAPS}
    made = {
        f"/camera/{path.stem}/{name}/image": path for name in ("generated", "truth") for path in (folder / name).glob("*.png")
    }
    return {topic: path.read_bytes() for topic, path in (maps | made).items()}


def test_the_file_equals_the_folder(rollout: Path) -> None:
    topics, metadata = read(rollout.parent / "a.mcap")
    rows = rows_of(rollout)
    assert len(rows) == STEPS + 1
    at = {topic: dict(messages) for topic, messages in topics.items()}
    origin = np.array(json.loads(metadata["log"]["map_origin"]))
    found: Counter[str] = Counter()
    for row in rows:
        time = 1000 * row["t_us"]
        for topic, png in images_of(rollout, row["step"]).items():
            assert at[topic][time].data == png and at[topic][time].format == "png", topic
            found[topic] += 1
        poses = {item.child_frame_id: matrix(item.rotation, item.translation) for item in at["/tf"][time].transforms}
        poses["ego"][:3, 3] += origin
        np.testing.assert_allclose(poses["ego"], row["ego"]["global_from_ego"], atol=1e-9)
        assert set(poses) == {"ego"} | {f"camera/{camera}" for camera in CAMERAS}
        entities = at["/actors"][time].entities
        assert [entity.id for entity in entities] == [actor["track"] for actor in row["actors"]]
        for entity, actor in zip(entities, row["actors"], strict=True):
            box = matrix(entity.cubes[0].pose.orientation, entity.cubes[0].pose.position)
            np.testing.assert_allclose(box[:3, 3] + origin, actor["center_m"], atol=1e-9)
            assert abs(math.remainder(math.atan2(box[1, 0], box[0, 0]) - actor["heading_rad"], math.tau)) < 1e-9
            assert vector(entity.cubes[0].size).tolist() == actor["size_m"]
        if row["plan"]:
            points = at["/plan"][time].entities[0].lines[0].points
            expected = [[waypoint["x_m"], waypoint["y_m"]] for waypoint in row["plan"]]
            np.testing.assert_allclose([vector(point)[:2] + origin[:2] for point in points], expected, atol=1e-9)
            found["/plan"] += 1
    images = {topic: len(messages) for topic, messages in topics.items() if topic.endswith(("image", *MAPS)) or topic == "/plan"}
    assert images == found and found["/camera/CAM_BACK/generated/image"] == 5 and found["/plan"] == 1
    metrics = {name: json.loads(text) for name, text in metadata["metrics"].items()}
    assert metrics == json.loads((rollout / "metrics.json").read_text())
    assert topics["/log"][-1][1].message == "all steps are simulated"


def test_rerun_reads_the_recording(rollout: Path, run: Run) -> None:
    chunk: Any = pytest.importorskip("rerun.chunk")
    out = rollout.parent / "a.rrd"
    done = run("-m", "pskel.rerun", str(rollout.parent / "a.mcap"), f"--out={out}")
    rows = rows_of(rollout)
    pictures = [images_of(rollout, row["step"]) for row in rows]
    boxes = [len(row["actors"]) for row in rows]
    plans = sum(bool(row["plan"]) for row in rows)
    poses = len(rows) * (1 + len(CAMERAS))
    for count in (f"{poses} poses", f"{sum(map(len, pictures))} images", f"{sum(boxes) + len(rows)} boxes", f"{plans} lines"):
        assert count in done.stdout, done.stdout
    assert sorted(path.name for path in rollout.parent.iterdir()) == ["a.mcap", "a.rrd", "out"]
    # Values of each component by entity, with their times.
    found: dict[tuple[str, str], dict[int, Any]] = {}
    for item in chunk.RrdReader(out).stream():
        batch = item.to_record_batch()
        if "time" not in batch.schema.names:
            continue
        times = batch.column("time").cast("int64").to_pylist()
        for name in (name for name in batch.schema.names if ":" in name):  # components
            values = dict(zip(times, batch.column(name).to_pylist(), strict=True))
            found.setdefault((item.entity_path, name), {}).update({time: value for time, value in values.items() if value is not None})
    for row, files, count in zip(rows, pictures, boxes, strict=True):
        time = 1000 * row["t_us"]
        for topic, png in files.items():
            entity = "/map/ego" + topic.removesuffix("/image")
            assert bytes(found[entity, "EncodedImage:blob"][time][0]) == png
            assert time in found[entity, "Pinhole:image_from_camera"]
        centers = found["/map/actors", "Boxes3D:centers"][time]
        first = np.array(rows[0]["ego"]["global_from_ego"])[:3, 3]
        expected = [np.array(actor["center_m"]) - first for actor in row["actors"]]
        np.testing.assert_allclose(np.array(centers), np.array(expected), atol=1e-4)  # single precision
        assert len(centers) == count and len(found["/map/ego/box", "Boxes3D:centers"][time]) == 1
        translation = found["/map/ego", "Transform3D:translation"][time][0]
        np.testing.assert_allclose(translation, np.array(row["ego"]["global_from_ego"])[:3, 3] - first, atol=1e-4)
    assert len(found["/map/plan", "LineStrips3D:strips"]) == plans
    texts = [values[0] for values in found["/log", "TextLog:text"].values()]
    assert texts[-1] == "rollout: all steps are simulated"


def test_rerun_refuses_other_files(tmp_path: Path, run: Run) -> None:
    pytest.importorskip("rerun")
    pytest.importorskip("mcap")
    (tmp_path / "a.txt").write_text("a text, no log")
    for name, parts in {"a.txt": ["expected an MCAP file of pskel, found", "a.txt"], "none": ["No such file", "none"]}.items():
        done = run("-m", "pskel.rerun", str(tmp_path / name), f"--out={tmp_path / 'a.rrd'}", check=False)
        assert done.returncode == 1 and len(done.stderr.splitlines()) == 1 and all(part in done.stderr for part in parts)
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
