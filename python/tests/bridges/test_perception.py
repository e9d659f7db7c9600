"""Generated samples alone, as nuscenes-devkit reads and evaluates them.

The devkit needs an environment of its own: its Python is named by PSKEL_NUSCENES_PYTHON.
"""

import json
import math
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

PYTHON = os.environ.get("PSKEL_NUSCENES_PYTHON")
TESTS = Path(__file__).parent
#: Categories of the ten classes of the detection benchmark.
CATEGORIES = [
    "vehicle.car",
    "vehicle.truck",
    "vehicle.bus.rigid",
    "vehicle.trailer",
    "vehicle.construction",
    "human.pedestrian.adult",
    "vehicle.motorcycle",
    "vehicle.bicycle",
    "movable_object.trafficcone",
    "movable_object.barrier",
]
FRAMES = 10

pytestmark = pytest.mark.skipif(PYTHON is None, reason="needs PSKEL_NUSCENES_PYTHON")


def run(*command):
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """A town at 6 Hz with objects of all ten classes: its models keep their shapes, and get other categories."""
    folder = tmp_path_factory.mktemp("town")
    run(sys.executable, "-m", "pskel", "town", f"seed=3,frames={FRAMES},hz=6,size=45x80", "--out", folder / "data")
    (folder / "recipe.json").write_text('{"drawn": "45x80", "size": "45x80"}')
    tables = folder / "data/v1.0-town"
    boxes = json.loads((tables / "sample_annotation.json").read_text())
    hit = Counter(box["instance_token"] for box in boxes if box["num_lidar_pts"] > 5)
    instances = sorted(json.loads((tables / "instance.json").read_text()), key=lambda instance: -hit[instance["token"]])
    for place, instance in enumerate(instances):
        instance["category_token"] = f"category-{place % len(CATEGORIES)}"
    categories = [
        {"token": f"category-{place}", "name": name, "description": ""} for place, name in enumerate(CATEGORIES)
    ]
    (tables / "instance.json").write_text(json.dumps(instances))
    (tables / "category.json").write_text(json.dumps(categories))
    return folder


@pytest.mark.parametrize(("part", "every"), [("6hz", 1), ("2hz", 3)])
def test_detection_of_the_truth_is_perfect_on_generated_samples(town, tmp_path, part, every):
    """Ground-truth boxes as the result reach mAP 1 on exactly the generated samples, in all ten classes."""
    options = ["--other-logs", "--parts", part, "--copy", part, "--generated-only", "--skeletons", town / "skeletons"]
    options += [
        "--generator",
        "fill",
        "--recipe",
        town / "recipe.json",
        "--window",
        "2",
        "--maps",
        "color",
        "--size",
        "45x80",
    ]
    log = f"nuscenes:{town / 'data'}@v1.0-town"
    run(sys.executable, "-m", "pskel", "protocol", "nuscenes-val", log, *options, "--out", tmp_path / "out")
    dataset = tmp_path / "out/dataset"
    # After a reference, every or every third sample, to the end of the log.
    source = sorted(
        json.loads((town / "data/v1.0-town/sample.json").read_text()), key=lambda sample: sample["timestamp"]
    )
    expected = [sample["token"] for sample in source[every::every]]
    listed = json.loads((dataset / "generated.json").read_text())["samples"]
    assert [sample["token"] for sample in listed] == expected
    assert all((dataset / name).stat().st_size > 0 for sample in listed for name in sample["images"].values())
    # The devkit walks all chains both ways, and reads sweeps, boxes and maps.
    counts = json.loads(run(PYTHON, TESTS.parents[2] / "tests/peers/devkit.py", dataset))
    assert counts["sample"] == len(expected) and counts["sample_data"] == 7 * len(expected)
    (tmp_path / "eval").mkdir()
    scores = json.loads(run(PYTHON, TESTS / "detection_of_truth.py", dataset, tmp_path / "eval"))
    assert sorted(scores["samples"]) == sorted(expected)
    assert len(scores["boxes"]) == len(CATEGORIES)
    assert scores["mean_ap"] == pytest.approx(1, abs=1e-12)
    for errors in scores["label_tp_errors"].values():
        assert all(errors[name] == pytest.approx(0, abs=1e-6) for name in ("trans_err", "scale_err"))
        # Undefined for cones and barriers.
        assert math.isnan(errors["vel_err"]) or errors["vel_err"] == pytest.approx(0, abs=1e-6)
    if part == "2hz":
        # Without the boxes of a sample, they are missed.
        scores = json.loads(run(PYTHON, TESTS / "detection_of_truth.py", dataset, tmp_path / "eval", expected[0]))
        assert scores["mean_ap"] < 0.95
