"""Figures of UniAD, read from files and printed output in its layout (tools/test.py --eval bbox, v1.0 and v2.0)."""

import json
import subprocess
import sys
from collections import namedtuple

import pytest

pytest.importorskip("torch", reason="PyTorch is not installed")  # which pskel.metrics imports

from pskel.metrics.uniad import main

Printed = namedtuple("Printed", "stdout stderr")
LOG = """\
Occ-flow Val Results:
iou
12.0 & 11.0
Occ-flow Val Results:
iou
63.4 & 40.2
pq
54.7 & 33.5
sq
81.0 & 70.0
rq
67.5 & 47.9
num occ evaluated:4800
ratio occ evaluated: 88.9%
+-------------------------------------------------------------------+
|                uniad's definition planning metrics                |
+-------------+--------+--------+--------+--------+--------+--------+
|   metrics   |  0.5s  |  1.0s  |  1.5s  |  2.0s  |  2.5s  |  3.0s  |
+-------------+--------+--------+--------+--------+--------+--------+
|   obj_col   | 0.0000 | 0.0001 | 0.0002 | 0.0003 | 0.0004 | 0.0005 |
| obj_box_col | 0.0008 | 0.0010 | 0.0012 | 0.0015 | 0.0030 | 0.0061 |
|      L2     | 0.2300 | 0.5100 | 0.7300 | 0.9800 | 1.3000 | 1.6500 |
+-------------+--------+--------+--------+--------+--------+--------+
--------------------------------------------------
Evaluate on motion category, merge class for vehicles and pedestrians...
evaluate standard motion metrics...
+-------------+-------------+-------------+---------------+
| class names | min_ade_err | min_fde_err | miss_rate_err |
+-------------+-------------+-------------+---------------+
|     car     |    0.7080   |    1.0250   |     0.1510    |
|  pedestrian |    0.8000   |    1.1000   |     0.2000    |
+-------------+-------------+-------------+---------------+
evaluate motion mAP-minFDE metrics...
+-------------+-------------+-------------+---------------+
| class names | min_ade_err | min_fde_err | miss_rate_err |
+-------------+-------------+-------------+---------------+
|     car     |    0.9000   |    1.9000   |     0.9000    |
+-------------+-------------+-------------+---------------+
{'pts_bbox_NuScenes/NDS': 0.4985, 'drivable_iou': 0.69}
"""
#: Areas of two samples: intersection and union, in UniAD's order.
AREAS = {
    "drivable": [(30, 40), (10, 60)],
    "lanes": [(1, 10), (5, 6)],
    "divider": [(0, 5), (2, 3)],
    "crossing": [(0, 0), (0, 0)],
    "contour": [(1, 2), (1, 2)],
}


@pytest.fixture
def results(tmp_path):
    """A result folder with two samples, and the printed output."""
    folder = tmp_path / "test/base_e2e/Wed_May_27_22_00_28_2026"
    for name in ("det", "track", "motion"):
        (folder / name).mkdir(parents=True)
    maps = {}
    for place, token in enumerate(("s1", "s2")):
        maps[token] = {}
        for name, areas in AREAS.items():
            shared, both = areas[place]
            maps[token] |= {
                f"{name}_intersection": float(shared),
                f"{name}_union": float(both),
                f"{name}_iou": shared / both if both else float("nan"),
            }
    content = {"meta": {"use_camera": True}, "results": {"s1": [], "s2": []}, "map_results": maps}
    (folder / "results_nusc.json").write_text(json.dumps(content))
    (folder / "det/metrics_summary.json").write_text(
        json.dumps({"mean_ap": 0.3798, "nd_score": 0.4985, "tp_errors": {"trans_err": 0.6}})
    )
    (folder / "track/metrics_summary.json").write_text(
        json.dumps({"amota": 0.363, "amotp": 1.32, "recall": 0.46, "ids": 900})
    )
    # That of the last evaluation of motions, which is not the one that papers print.
    (folder / "metrics_summary.json").write_text(json.dumps({"label_tp_errors": {"car": {"min_ade_err": 9.0}}}))
    (tmp_path / "eval.log").write_text(LOG)
    return folder


@pytest.fixture
def uniad(capsys):
    def uniad(*arguments, status=0):
        assert main([str(argument) for argument in arguments]) == status
        return Printed(*capsys.readouterr())

    return uniad


def cells(done):
    header, _, row = [[cell.strip() for cell in line.strip("|").split("|")] for line in done.stdout.splitlines()]
    return dict(zip(header, row, strict=True))


def test_nine_columns_are_printed(uniad, results, tmp_path):
    done = uniad(results, "--log", tmp_path / "eval.log")
    # Sums over samples, not means of their ratios: (30 + 10) / (40 + 60). There is no crossing.
    maps = {"Lanes (%)": "37.50", "Drivable (%)": "40.00", "Divider (%)": "25.00", "Crossing (%)": "-"}
    detection = {"mAP (%)": "37.98", "NDS (%)": "49.85"}
    assert cells(done) == detection | maps | {"L2 1 s (m)": "0.51", "L2 2 s (m)": "0.98", "L2 3 s (m)": "1.65"}
    assert done.stderr == ""
    # The results by their file, too.
    command = [
        sys.executable,
        "-m",
        "pskel.metrics.uniad",
        results / "results_nusc.json",
        "--log",
        tmp_path / "eval.log",
    ]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == done.stdout


def test_all_figures_are_those_of_the_last_run(uniad, results, tmp_path):
    done = uniad(results, "--log", tmp_path / "eval.log", "--all", "--out", tmp_path / "figures.json")
    found = cells(done)
    assert (found["AMOTA"], found["AMOTP (m)"]) == ("0.363", "1.320")
    assert [found[name] for name in ("minADE (m)", "minFDE (m)", "MR")] == ["0.708", "1.025", "0.151"]
    assert [found[name] for name in ("IoU-n. (%)", "IoU-f. (%)", "VPQ-n. (%)", "VPQ-f. (%)")] == [
        "63.40",
        "40.20",
        "54.70",
        "33.50",
    ]
    assert [found[f"Col. {name} (%)"] for name in ("1 s", "2 s", "3 s", "avg.")] == ["0.10", "0.15", "0.61", "0.29"]
    written = json.loads((tmp_path / "figures.json").read_text())
    assert written["samples"] == 2 and written["planning_definition"] == "uniad" and written["missing"] == {}
    assert written["figures"]["L2 avg. (m)"] == pytest.approx((0.51 + 0.98 + 1.65) / 3, rel=1e-12)
    assert written["figures"]["Crossing (%)"] is None
    assert len(written["figures"]) == len(found)


def test_missing_pieces_are_named(uniad, results, tmp_path):
    (results / "det/metrics_summary.json").unlink()
    done = uniad(results)
    assert cells(done)["mAP (%)"] == cells(done)["L2 1 s (m)"] == "-"
    assert done.stderr.splitlines() == [
        "no detection: det/metrics_summary.json is missing",
        "no planning: UniAD prints it only: pass its output with --log",
    ]
    (tmp_path / "eval.log").write_text(LOG.replace("class names", "names").replace("uniad's", "stp3's"))
    done = uniad(results, "--log", tmp_path / "eval.log", "--all")
    assert f"no motion: no such table in {tmp_path / 'eval.log'}" in done.stderr.splitlines()
    assert "planning: means up to the time (stp3's definition), not the values at it" in done.stderr.splitlines()
    (results / "results_nusc.json").unlink()
    (results / "track/metrics_summary.json").unlink()
    done = uniad(results, status=1)
    assert (
        done.stderr.startswith("pskel.metrics.uniad: expected results of UniAD, found none (")
        and done.stderr.count("\n") == 1
    )


def test_results_of_another_set_are_refused(uniad, results, tmp_path):
    listed = tmp_path / "generated.json"

    def refused(tokens):
        listed.write_text(json.dumps({"version": "v1.0-trainval", "samples": [{"token": token} for token in tokens]}))
        return uniad(results, "--generated", listed, status=1).stderr

    listed.write_text(json.dumps({"samples": [{"token": "s2"}, {"token": "s1"}]}))
    uniad(results, "--generated", listed)
    where = f"results of the {{}} samples in {listed}, found"
    assert refused(["s1"]).startswith(
        f"pskel.metrics.uniad: expected {where.format(1)} 0 missing and 1 others ('s2' is another): "
    )
    assert refused(["s1", "s2", "s3"]).startswith(
        f"pskel.metrics.uniad: expected {where.format(3)} 1 missing and 0 others ('s3' is missing): "
    )
    listed.write_text("[]")
    assert (
        "expected the list of generated samples of a copy, found another file"
        in uniad(results, "--generated", listed, status=1).stderr
    )
    (results / "results_nusc.json").write_text("no JSON")
    assert uniad(results, status=1).stderr.startswith("pskel.metrics.uniad: expected JSON, found another file")
    (results / "results_nusc.json").write_text('{"results": []}')
    assert (
        "expected results of UniAD with boxes by sample (results), found another file"
        in uniad(results, status=1).stderr
    )
