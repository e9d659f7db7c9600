"""The columns of a protocol that networks compute, on a written town: rollouts with and without ground truth."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("torchmetrics", reason="torchmetrics is not installed")
pytest.importorskip("torch_fidelity", reason="torch-fidelity is not installed")
Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")

from PIL.PngImagePlugin import PngInfo
from test_metrics import i3d_weights, inception_weights, mask2former  # noqa: F401 # fixtures


def pskel(*arguments, status=0):
    command = [sys.executable, "-m", "pskel", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    return done


CAMERAS = ("CAM_FRONT", "CAM_BACK")


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """A town with two of its cameras: networks take a second for an image."""
    folder = tmp_path_factory.mktemp("town")
    pskel("town", "seed=3,frames=20,hz=5,lidar_hz=10,size=45x80", "--out", folder / "data")
    tables = {name: folder / f"data/v1.0-town/{name}.json" for name in ("sensor", "calibrated_sensor", "sample_data")}
    sensors, calibrated, data = (json.loads(path.read_text()) for path in tables.values())
    kept = {row["token"] for row in sensors if row["modality"] != "camera" or row["channel"] in CAMERAS}
    kept = {row["token"] for row in calibrated if row["sensor_token"] in kept}
    for name, key, rows in (("calibrated_sensor", "token", calibrated), ("sample_data", "calibrated_sensor_token", data)):
        tables[name].write_text(json.dumps([row for row in rows if row[key] in kept]))
    return folder


def protocol(town, *arguments, parts="replay,straight", status=0):
    log = f"nuscenes:{town / 'data'}@v1.0-town"
    (town / "recipe.json").write_text('{"drawn": "45x80", "size": "45x80"}')
    recipe = ["--generator", "fill", "--recipe", town / "recipe.json"]
    options = ["--other-logs", *recipe, "--maps", "color,class", "--size", "45x80"]
    folders = ["--skeletons", town / "skeletons", "--out", town / "out"]
    return pskel("protocol", "nuplan-simgen", log, "--parts", parts, *options, *folders, *arguments, status=status)


def cells(town):
    """The cells of the table by row and column."""
    header, _, *rows = [line.strip("| ").split(" | ") for line in (town / "out/table.md").read_text().splitlines() if line.startswith("|")]
    return {row[0]: dict(zip(header, row, strict=True)) for row in rows}


def pictures(folder, kind, of=("generated",)):
    """Image files of the steps with images of some kinds, by camera and then time."""
    steps = sorted(path.parent for path in folder.glob("steps/*/generated.json"))
    wanted = [step for step in steps if json.loads((step / "generated.json").read_text())["kind"] in of]
    cameras = sorted(path.name for path in (wanted[0] / kind).glob("*.png"))
    return [tuple(step / kind / camera for step in wanted) for camera in cameras]


def distance(a, b):
    """FID by the eigenvalues of a product as small as the number of images."""
    x, y = ((rows - rows.mean(0)) / np.sqrt(len(rows) - 1) for rows in (a, b))
    product = x @ y.T
    shared = np.sqrt(np.clip(np.linalg.eigvalsh(product @ product.T), 0, None)).sum()
    return ((a.mean(0) - b.mean(0)) ** 2).sum() + (x**2).sum() + (y**2).sum() - 2 * shared


def test_columns_are_those_of_torchmetrics(town, inception_weights, mask2former):  # noqa: F811
    """FID of replayed and off-log rollouts, and IoU, of the same images; a second run computes nothing again."""
    from torchmetrics.image.fid import NoTrainInceptionV3

    from pskel.metrics import Video
    from pskel.metrics.networks import Inception

    networks = ["--inception", inception_weights, "--segmentor", mask2former]
    done = protocol(town, *networks)
    table, results = (town / "out/table.md").read_bytes(), (town / "out/results.json").read_bytes()
    assert "FVD needs --i3d." in done.stdout and "IoU needs" not in done.stdout
    network = NoTrainInceptionV3("inception-v3-compat", ["2048"], str(inception_weights)).eval()
    kept = sorted((town / "out/metrics/features").iterdir())
    assert len(kept) == 4 * len(CAMERAS)  # replayed, its truth; off the log, all truth of the replay
    package = Inception(inception_weights, town / "out/metrics/features", "cpu")

    def features(folder, kind, of=("generated",), as_kind=None, size=None):
        """Features that the protocol has kept, of all cameras; those of the first camera compared with torchmetrics."""
        videos = [Video(as_kind or kind, paths, size) for paths in pictures(folder, kind, of)]
        rows = [package.features(video) for video in videos]
        with torch.inference_mode():
            expected = network(torch.from_numpy(videos[0].read()).permute(0, 3, 1, 2)).numpy()
        np.testing.assert_allclose(rows[0], expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
        return np.concatenate(rows).astype(np.float64)

    replay, straight = (next((town / "out" / part).iterdir()) for part in ("replay", "straight"))
    assert not list(straight.glob("steps/*/truth"))
    generated, truth = features(replay, "generated"), features(replay, "truth")
    assert generated.shape == truth.shape == (17 * len(CAMERAS), 2048)
    off_log, logged = features(straight, "generated"), features(replay, "truth", ("reference", "generated"), "reference", (45, 80))
    assert len(off_log) == 28 * len(CAMERAS) and len(logged) == 20 * len(CAMERAS)
    assert sorted((town / "out/metrics/features").iterdir()) == kept
    parts = {part["name"]: part for part in json.loads(results)["parts"]}
    for part, one, other in (("replay", generated, truth), ("straight", off_log, logged)):
        found = parts[part]["fid"]
        assert found["samples"] == [len(one), len(other)]
        assert found["distance"] == pytest.approx(distance(one, other), rel=1e-6)
        assert float(cells(town)[part]["FID"]) == pytest.approx(found["distance"], abs=0.006)
        assert cells(town)[part]["FVD"] == "-" and parts[part]["fvd"] is None
        assert parts[part]["images"]["mean"]["iou_masks"]["mean"] is not None
        assert re.fullmatch(r"[0-9.]+", cells(town)[part]["IoU (%)"])
    masks = sorted((town / "out/metrics/masks").rglob("*.png"))
    assert len(masks) == (17 + 28) * len(CAMERAS)
    # As an interrupted run leaves it.
    times = {path: path.stat().st_mtime_ns for path in (town / "out/metrics").rglob("*") if path.is_file()}
    removed = [masks[3], *sorted((town / "out/metrics/features").iterdir())[:2]]
    before = {path: path.read_bytes() for path in removed}
    for path in [*removed, town / "out/table.md", town / "out/results.json"]:
        path.unlink()
    protocol(town, *networks)
    assert (town / "out/table.md").read_bytes() == table and (town / "out/results.json").read_bytes() == results
    assert all(path.read_bytes() == content for path, content in before.items())
    assert all(path.stat().st_mtime_ns == time for path, time in times.items() if path not in removed)
    # With the vehicles of the class maps as masks, and the mark of the model: the IoU is high, and depends on the rule.
    for path in masks:
        part, clip, step = path.parts[-4:-1]
        key = Image.open(path).info["source"]
        info = PngInfo()
        info.add_text("source", key)
        vehicles = np.asarray(Image.open(town / "out" / part / clip / "steps" / step / path.stem / "class.png")) == 1
        Image.fromarray(vehicles.astype(np.uint8) * 255).save(path, pnginfo=info)
    means = []
    for rule in ("closing", "paper"):
        protocol(town, "--segmentor", mask2former, "--mask-rule", rule)
        found = json.loads((town / "out/results.json").read_text())
        assert found["mask_rule"] == rule
        means.append({part["name"]: part["images"]["mean"]["iou_masks"]["mean"] for part in found["parts"]})
    for part in ("replay", "straight"):
        closing, blur = (mean[part] for mean in means)
        assert 0.5 < closing < 1 and 0.5 < blur < 1 and closing != blur


def test_fvd_is_that_of_clips(town, i3d_weights):  # noqa: F811
    from pskel.metrics import I3D, video_features

    protocol(town, "--i3d", i3d_weights, parts="replay")
    ((replay,),) = [list((town / "out/replay").iterdir())]
    network = I3D.load(i3d_weights)
    sets = []
    for kind in ("generated", "truth"):
        videos = [np.stack([np.asarray(Image.open(path)) for path in paths]) for paths in pictures(replay, kind)]
        clips = [video[start : start + 16] for video in videos for start in (0, 1)]
        sets.append(video_features(network, clips).astype(np.float64))
    (part,) = json.loads((town / "out/results.json").read_text())["parts"]
    assert part["fvd"]["samples"] == [2 * len(CAMERAS)] * 2 and part["fid"] is None
    assert part["fvd"]["distance"] == pytest.approx(distance(*sets), rel=1e-6)


def test_missing_networks_are_reported(town, inception_weights, i3d_weights):  # noqa: F811
    (town / "text.pth").write_text("no weights")
    for arguments, said in (
        (["--inception", town / "text.pth"], "expected weights of Inception by torch-fidelity, found another file"),
        (["--inception", town / "none.pth"], "cannot read "),
        (["--i3d", inception_weights], "missing tensors: "),
        (["--segmentor", town], "expected a folder of Mask2Former with config.json, found none"),
        (["--inception", inception_weights, "--python", "/bin/none"], "metrics need Python with the package pskel[metrics]"),
    ):
        done = protocol(town, *arguments, parts="replay", status=1)
        assert said in done.stderr.splitlines()[-1], (arguments, done.stderr)
    done = protocol(town, "--mask-rule", "paper", parts="replay", status=2)
    assert "--segmentor" in done.stderr
    # Off the log, and no part that follows it.
    done = protocol(town, "--inception", inception_weights, parts="straight")
    assert "note: straight: no FID and FVD: without ground truth they need the images of a part that follows the log" in done.stderr
