"""FID and FVD features: torchmetrics, and the sums of an independent computation, on random weights."""

import contextlib
import csv
import io
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("torchmetrics", reason="torchmetrics is not installed")
pytest.importorskip("torch_fidelity", reason="torch-fidelity is not installed")
Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")

from torch.nn import functional

from pskel.metrics import I3D, frechet_distance, image_features, load_inception, read_reference, read_rollout, video_features
from pskel.metrics.__main__ import main


def initialized(network, seed):
    """Weights of a scale at which features depend on the input."""
    generator = torch.Generator().manual_seed(seed)
    for name, tensor in network.state_dict().items():
        if tensor.ndim > 1:
            tensor.normal_(0, (2 / tensor[0].numel()) ** 0.5, generator=generator)
        elif "running_var" in name or name.endswith("bn.weight"):
            tensor.uniform_(0.5, 1.5, generator=generator)
        elif tensor.is_floating_point():
            tensor.normal_(0, 0.1, generator=generator)
    return network


@pytest.fixture(scope="session")
def i3d_weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("i3d") / "i3d.pt"
    torch.save(initialized(I3D(), 1).state_dict(), path)
    return path


@pytest.fixture(scope="session")
def inception_weights(tmp_path_factory):
    """Random weights of torch-fidelity's network, which only loads files."""
    from torch_fidelity.feature_extractor_inceptionv3 import FeatureExtractorInceptionV3

    path = tmp_path_factory.mktemp("inception") / "inception.pth"
    torch.save({}, path)
    loads, FeatureExtractorInceptionV3.load_state_dict = FeatureExtractorInceptionV3.load_state_dict, lambda *_, **__: None
    try:
        network = FeatureExtractorInceptionV3("inception-v3-compat", ["2048"], str(path))
    finally:
        FeatureExtractorInceptionV3.load_state_dict = loads
    torch.save(initialized(network, 2).state_dict(), path)
    return path


def images(seed, *shape):
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3), np.uint8)


def test_image_features_are_those_of_torchmetrics(inception_weights):
    from torchmetrics.image.fid import FrechetInceptionDistance

    metric = FrechetInceptionDistance(feature=2048, feature_extractor_weights_path=str(inception_weights))
    levels = images(3, 6, 64, 112)
    own = image_features(load_inception(inception_weights), levels, batch=4)
    expected = metric.inception(torch.from_numpy(levels).permute(0, 3, 1, 2))
    np.testing.assert_allclose(own, expected, rtol=1e-4, atol=1e-4)
    assert own.shape == (6, 2048) and own.std(0).max() > 1e-3


def test_distance_is_that_of_torchmetrics():
    from torchmetrics.image.fid import _compute_fid

    rng = np.random.default_rng(5)
    # Correlated columns of different variance, and more rows than columns.
    mix = rng.normal(size=(24, 24)) * np.linspace(0.1, 3, 24)
    a, b = rng.normal(size=(200, 24)) @ mix, 0.3 + rng.normal(size=(150, 24)) @ mix.T
    tensors = [torch.from_numpy(x) for x in (a, b)]
    expected = _compute_fid(tensors[0].mean(0), tensors[0].T.cov(), tensors[1].mean(0), tensors[1].T.cov())
    assert frechet_distance(a, b) == pytest.approx(float(expected), rel=1e-6)
    assert frechet_distance(a, a) == pytest.approx(0, abs=1e-6 * np.trace(np.cov(a.T)))
    with pytest.raises(ValueError, match="expected features"):
        frechet_distance(a, b[:, :3])


def test_convolutions_are_padded_as_in_tensorflow(i3d_weights):
    """The stem of I3D computed step by step: 7x7x7 kernels at a stride of 2, two zeros before and three behind."""
    network = I3D.load(i3d_weights)
    clip = torch.from_numpy(np.random.default_rng(6).normal(size=(1, 3, 16, 32, 48))).float()
    unit = network.Conv3d_1a_7x7
    raw = functional.conv3d(functional.pad(clip, [2, 3] * 3), unit.conv3d.weight, stride=2)
    scale = unit.bn.weight / (unit.bn.running_var + 0.001).sqrt()
    shape = (1, -1, 1, 1, 1)
    expected = torch.relu((raw - unit.bn.running_mean.view(shape)) * scale.view(shape) + unit.bn.bias.view(shape))
    assert raw.shape == (1, 64, 8, 16, 24)
    torch.testing.assert_close(unit(clip), expected, rtol=1e-4, atol=1e-4)


def test_i3d_has_the_published_names():
    names = I3D().state_dict()
    # 57 units of a convolution and a norm with 5 tensors each, and the logits.
    assert len(names) == 57 * 6 + 2
    assert names["Mixed_4e.b1b.conv3d.weight"].shape == (288, 144, 3, 3, 3)
    assert names["logits.conv3d.weight"].shape == (400, 1024, 1, 1, 1)
    assert names["Conv3d_1a_7x7.bn.num_batches_tracked"].shape == ()


def test_video_features_do_not_depend_on_batches(i3d_weights):
    network = I3D.load(i3d_weights)
    clips = images(7, 3, 10, 32, 56)
    whole = video_features(network, clips, batch=3)
    assert whole.shape == (3, 400) and whole.dtype == np.float32
    np.testing.assert_allclose(video_features(network, list(clips), batch=1), whole, rtol=1e-3, atol=1e-4)
    assert np.abs(whole[0] - whole[1]).max() > 1e-3


def write_rollout(folder, frames, references=2):
    for step in range(frames + references):
        at = folder / "steps" / f"{2 * step:06}"
        is_reference = step < references
        for kind, seed in (("generated", 10), ("truth", 20)):
            (at / kind).mkdir(parents=True)
            for camera in ("CAM_BACK", "CAM_FRONT"):
                Image.fromarray(images([seed, step, len(camera)], 32, 56)).save(at / kind / f"{camera}.png")
        (at / "generated.json").write_text(json.dumps({"kind": "reference" if is_reference else "generated"}))
    # A step between plans has no images.
    (folder / "steps" / "000001").mkdir()
    return folder


def write_reference(folder, frames):
    """Recorded images of two cameras, larger than the generated ones."""
    for camera, seed in (("CAM_BACK", 30), ("CAM_FRONT", 31)):
        (folder / camera).mkdir(parents=True)
        for frame in range(frames):
            Image.fromarray(images([seed, frame], 64, 112)).save(folder / camera / f"{frame:06}.jpg", quality=95)
    return folder


def run(*arguments):
    """The command in this process: importing PyTorch takes seconds."""
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        try:
            status = main([str(argument) for argument in arguments])
        except SystemExit as exit:
            status = exit.code
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), error.getvalue())


def test_command_writes_features_and_curve(tmp_path, inception_weights, i3d_weights):
    rollout = write_rollout(tmp_path / "rollout", 12)
    assert [video.camera for video in read_rollout(rollout)] == ["CAM_BACK", "CAM_FRONT"]
    assert read_rollout(rollout)[0].steps == list(range(4, 28, 2))
    weights = ["--inception", inception_weights, "--i3d", i3d_weights, "--frames", "10"]
    command = [sys.executable, "-m", "pskel.metrics", rollout, *weights, "--out", tmp_path / "out"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "24 samples of 2048 features" in done.stdout and "6 samples of 400 features" in done.stdout
    features = {path.stem: np.load(path) for path in (tmp_path / "out").glob("*.npy")}
    assert {name: each.shape for name, each in features.items()} == {
        "inception-generated": (24, 2048),
        "inception-truth": (24, 2048),
        "i3d-generated": (6, 400),
        "i3d-truth": (6, 400),
    }
    printed = [float(line.split()[1].rstrip(",")) for line in done.stdout.splitlines()]
    for name, value in zip(("inception", "i3d"), printed, strict=True):
        assert frechet_distance(features[f"{name}-generated"], features[f"{name}-truth"]) == pytest.approx(value, abs=1e-3)
    with (tmp_path / "out/curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["first_frame"] for row in rows] == ["0", "1", "2"]
    parts = {kind: [features[f"inception-{kind}"][at : at + 10] for at in (1, 13)] for kind in ("generated", "truth")}
    window = {kind: np.concatenate(both) for kind, both in parts.items()}
    assert float(rows[1]["fid"]) == pytest.approx(frechet_distance(window["generated"], window["truth"]), rel=1e-9)
    clips = {kind: features[f"i3d-{kind}"][[2, 5]] for kind in ("generated", "truth")}
    assert float(rows[2]["fvd"]) == pytest.approx(frechet_distance(clips["generated"], clips["truth"]), rel=1e-9)


def test_wrong_input_is_reported(tmp_path, i3d_weights):
    rollout = write_rollout(tmp_path / "rollout", 3)
    weights = torch.load(i3d_weights, weights_only=True)
    name = "Mixed_4e.b1b.conv3d.weight"
    for change, said in (
        ({name: None}, f"1 missing tensors: {name}"),
        ({"more": torch.zeros(1)}, "1 additional tensors: more"),
        ({name: torch.zeros(2, 3)}, f"1 misshapen tensors: {name} of [2, 3] instead of [288, 144, 3, 3, 3]"),
    ):
        bad = tmp_path / "bad.pt"
        torch.save({key: tensor for key, tensor in (weights | change).items() if tensor is not None}, bad)
        with pytest.raises(ValueError) as error:
            I3D.load(bad)
        assert str(bad) in str(error.value) and said in str(error.value)
    (tmp_path / "text.pt").write_text("no weights")
    (tmp_path / "empty").mkdir()
    out = ["--out", tmp_path / "out"]
    for arguments, status, said in (
        ([rollout, *out], 2, "expected --inception or --i3d"),
        ([rollout, "--i3d", i3d_weights, "--frames", 4, *out], 2, "expected --frames of 10 or more, found 4"),
        ([rollout, "--i3d", i3d_weights, *out], 1, "expected a rollout of 16 generated frames or more, found at most 3"),
        ([tmp_path / "empty", "--i3d", i3d_weights, *out], 1, "expected a rollout with generated images, found none"),
        ([rollout, "--i3d", tmp_path / "text.pt", "--frames", 10, *out], 1, "found at most 3"),
        ([rollout, "--inception", tmp_path / "text.pt", *out], 1, "expected weights of Inception"),
        ([rollout, "--inception", tmp_path / "none.pth", *out], 1, "none.pth: No such file"),
    ):
        done = run(*arguments)
        assert done.returncode == status and said in done.stderr, (arguments, done.stderr)
    (rollout / "steps/000006/truth/CAM_FRONT.png").unlink()
    done = run(rollout, "--inception", tmp_path / "none.pth", *out)
    assert done.returncode == 1 and "expected a truth image, found none" in done.stderr


def test_rollouts_without_ground_truth_are_compared_with_reference_images(tmp_path, inception_weights, i3d_weights):
    rollout, other = write_rollout(tmp_path / "off", 11), write_rollout(tmp_path / "on", 12)
    for folder in rollout.glob("steps/*/truth"):
        shutil.rmtree(folder)
    weights = ["--inception", inception_weights, "--i3d", i3d_weights, "--frames", 10, "--out", tmp_path / "out"]
    done = run(rollout, *weights)
    assert done.returncode == 1
    assert "expected a truth image, found none" in done.stderr and "--reference compares with other images" in done.stderr
    recorded = write_reference(tmp_path / "recorded", 13)
    done = run(rollout, *weights, "--reference", recorded)
    assert done.returncode == 0, done.stderr
    assert "22 and 26 samples of 2048 features" in done.stdout and "4 and 8 samples of 400 features" in done.stdout
    features = {path.stem: np.load(path) for path in (tmp_path / "out").glob("*.npy")}
    assert sorted(features) == ["i3d-generated", "i3d-reference", "inception-generated", "inception-reference"]
    resized = [np.asarray(Image.open(path).resize((56, 32), Image.Resampling.BILINEAR)) for path in sorted(recorded.glob("*/*.jpg"))]
    expected = image_features(load_inception(inception_weights), np.stack(resized))
    np.testing.assert_allclose(features["inception-reference"], expected, rtol=1e-4, atol=1e-4)
    with (tmp_path / "out/curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["first_frame"] for row in rows] == ["0", "1"]
    window = np.concatenate([features["inception-generated"][at : at + 10] for at in (1, 12)])
    assert float(rows[1]["fid"]) == pytest.approx(frechet_distance(window, expected), rel=1e-3)
    # Rollouts with ground truth are references too: the images of all their steps.
    assert [len(video) for video in read_reference(other, (32, 56))] == [14, 14]
    np.testing.assert_array_equal(read_reference(other, (32, 56))[0].read()[2], read_rollout(other)[0].truth.read()[0])
    assert read_reference(recorded / "CAM_BACK", (32, 56))[0].read().shape == (13, 32, 56, 3)
    (tmp_path / "empty").mkdir()
    done = run(rollout, *weights, "--reference", recorded, tmp_path / "empty")
    assert done.returncode == 1 and "expected a rollout with ground truth, or a folder of PNG or JPEG images" in done.stderr
    (tmp_path / "empty/a.png").write_text("no image")
    done = run(rollout, *weights, "--reference", tmp_path / "empty")
    assert done.returncode == 1 and "expected a reference image, found another file" in done.stderr


def test_features_are_computed_once(tmp_path, inception_weights):
    """An interrupted run continues, and its files are those of an uninterrupted one."""
    rollouts = [write_rollout(tmp_path / name, 3) for name in ("a", "b")]
    weights = ["--inception", inception_weights, "--out"]
    once = run(*rollouts, *weights, tmp_path / "once")
    assert once.returncode == 0, once.stderr
    assert run(rollouts[0], *weights, tmp_path / "parts").returncode == 0
    cached = {path: path.stat().st_mtime_ns for path in (tmp_path / "parts/cache").iterdir()}
    assert len(cached) == 4  # 2 cameras, generated and truth
    # As a killed process leaves it.
    (tmp_path / "parts/cache/.inception-0.npy.partial").write_bytes(b"half")
    sorted(cached)[0].write_bytes(b"")
    done = run(*rollouts, *weights, tmp_path / "parts")
    assert done.returncode == 0 and done.stdout == once.stdout, done.stderr
    for path in sorted((tmp_path / "once").rglob("*")):
        if path.is_file():
            assert path.read_bytes() == (tmp_path / "parts" / path.relative_to(tmp_path / "once")).read_bytes(), path
    unchanged = [path for path, time in cached.items() if path.stat().st_mtime_ns == time]
    assert len(unchanged) == 3
    # Another image has other features.
    Image.fromarray(images(99, 32, 56)).save(rollouts[1] / "steps/000006/generated/CAM_BACK.png")
    assert run(*rollouts, *weights, tmp_path / "parts").stdout != once.stdout


def ask(*requests):
    text = "".join(json.dumps(request) + "\n" for request in requests)
    done = subprocess.run(
        [sys.executable, "-m", "pskel.metrics.server"], input=text, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_server_answers_as_the_command(tmp_path, inception_weights, i3d_weights):
    long, short = write_rollout(tmp_path / "long", 17), write_rollout(tmp_path / "short", 3)
    cache = str(tmp_path / "out/cache")
    weights = {"inception": str(inception_weights), "i3d": str(i3d_weights), "cache": cache, "device": "cpu"}
    whole, few, missing, unknown = ask(
        {"distances": {"rollouts": [str(long)], "references": None, **weights}},
        {"distances": {"rollouts": [str(short)], "references": [str(long)], **weights}},
        {"distances": {"rollouts": [str(tmp_path)], "references": None, **weights}},
        {"other": {}},
    )
    done = run(long, "--inception", inception_weights, "--i3d", i3d_weights, "--out", tmp_path / "out")
    written = json.loads((tmp_path / "out/metrics.json").read_text())
    assert whole == {**written, "notes": []}, done.stderr
    assert few["fid"]["samples"] == [6, 38] and few["fvd"] is None
    assert few["notes"] == ["no FVD: expected a rollout of 16 generated frames or more, found at most 3"]
    assert missing == {"error": f"expected a rollout with generated images, found none: {tmp_path}"}
    assert unknown == {"error": "expected distances or masks, found other"}


CITYSCAPES = (
    "road,sidewalk,building,wall,fence,pole,traffic light,traffic sign,vegetation,terrain,sky,"
    "person,rider,car,truck,bus,train,motorcycle,bicycle"
)


@pytest.fixture(scope="session")
def mask2former(tmp_path_factory):
    """A tiny Mask2Former with random weights."""
    transformers = pytest.importorskip("transformers", reason="transformers is not installed")
    pytest.importorskip("scipy", reason="SciPy is not installed")
    names = CITYSCAPES.split(",")
    backbone = transformers.SwinConfig(
        image_size=64, patch_size=4, embed_dim=12, depths=[1] * 4, num_heads=[1, 2, 3, 4], window_size=4, drop_path_rate=0.0,
        out_features=["stage1", "stage2", "stage3", "stage4"],
    )  # fmt: skip
    config = transformers.Mask2FormerConfig(
        backbone_config=backbone, feature_size=32, mask_feature_size=32, hidden_dim=32, encoder_feedforward_dim=32, dim_feedforward=32,
        encoder_layers=1, decoder_layers=2, num_attention_heads=4, num_queries=8, id2label=dict(enumerate(names)),
        label2id={name: number for number, name in enumerate(names)},
    )  # fmt: skip
    torch.manual_seed(4)
    folder = tmp_path_factory.mktemp("mask2former")
    transformers.Mask2FormerForUniversalSegmentation(config).eval().save_pretrained(folder)
    size = {"height": 96, "width": 96}
    transformers.Mask2FormerImageProcessor(size=size, ignore_index=255, do_reduce_labels=False, num_labels=19).save_pretrained(folder)
    return folder


def test_masks_are_those_of_the_model(tmp_path, mask2former, capsys):
    from transformers import AutoImageProcessor, Mask2FormerForUniversalSegmentation

    from pskel.metrics.masks import VEHICLES, main

    rollout = write_rollout(tmp_path / "rollout", 3)
    arguments = [str(rollout), "--mask2former", str(mask2former)]
    assert main(arguments) == 0
    assert capsys.readouterr().out == f"6 of 6 masks written, 0 were there: {rollout / 'masks'}\n"
    network = Mask2FormerForUniversalSegmentation.from_pretrained(mask2former).eval()
    processor = AutoImageProcessor.from_pretrained(mask2former)
    vehicles = [number for number, name in network.config.id2label.items() if name in VEHICLES]
    assert len(vehicles) == 4  # car, truck, bus, train
    written = sorted((rollout / "masks").rglob("*.png"))
    assert [str(path.relative_to(rollout / "masks")) for path in written[:2]] == ["000004/CAM_BACK.png", "000004/CAM_FRONT.png"]
    for path in written:
        image = np.asarray(Image.open(rollout / "steps" / path.parent.name / "generated" / path.name))
        with torch.inference_mode():
            outputs = network(**processor(images=[image], return_tensors="pt"))
        classes = processor.post_process_semantic_segmentation(outputs, target_sizes=[(32, 56)])[0].numpy()
        np.testing.assert_array_equal(np.asarray(Image.open(path)), np.isin(classes, vehicles) * np.uint8(255))
    # Only masks of other images are written again.
    before = {path: path.read_bytes() for path in written}
    written[0].unlink()
    Image.fromarray(images(98, 32, 56)).save(rollout / "steps/000006/generated/CAM_BACK.png")
    assert main(arguments) == 0
    assert capsys.readouterr().out.startswith("2 of 6 masks written, 4 were there")
    assert written[0].read_bytes() == before[written[0]]


def test_masks_are_written_once_for_each_model(tmp_path):
    from pskel.metrics.masks import write_masks

    rollout = write_rollout(tmp_path / "rollout", 2)
    calls = []

    def segmentor(image):
        calls.append(image.shape)
        return image[..., 0] > 128

    assert write_masks(rollout, tmp_path / "masks", segmentor, "stub") == (4, 4)
    assert write_masks(rollout, tmp_path / "masks", segmentor, "stub") == (0, 4) and calls == [(32, 56, 3)] * 4
    assert write_masks(rollout, tmp_path / "masks", segmentor, "another") == (4, 4)
    image = np.asarray(Image.open(rollout / "steps/000004/generated/CAM_FRONT.png"))
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "masks/000004/CAM_FRONT.png")) > 0, image[..., 0] > 128)
    (tmp_path / "masks/000004/CAM_FRONT.png").write_text("mine")
    with pytest.raises(ValueError, match="expected a mask to replace, found another file"):
        write_masks(rollout, tmp_path / "masks", segmentor, "another")


def test_wrong_segmentors_are_reported(tmp_path, mask2former, capsys):
    from pskel.metrics.masks import main

    rollout = write_rollout(tmp_path / "rollout", 2)
    (tmp_path / "empty").mkdir()
    shutil.copytree(mask2former, tmp_path / "classes")
    config = json.loads((tmp_path / "classes/config.json").read_text())
    config["id2label"] = {number: f"LABEL_{number}" for number in config["id2label"]}
    config["label2id"] = {name: int(number) for number, name in config["id2label"].items()}
    (tmp_path / "classes/config.json").write_text(json.dumps(config))
    shutil.copytree(mask2former, tmp_path / "damaged")
    (tmp_path / "damaged/model.safetensors").write_bytes(b"no weights")
    for arguments, said in (
        ([rollout, "--mask2former", tmp_path / "none"], "expected a folder of Mask2Former, found none: "),
        ([rollout, "--mask2former", tmp_path / "empty"], "expected a folder of Mask2Former with config.json, found none"),
        ([rollout, "--mask2former", tmp_path / "classes"], "expected the semantic classes of Cityscapes, found 19 others (label_0, "),
        ([rollout, "--mask2former", tmp_path / "damaged"], "expected a folder of Mask2Former, found another ("),
        ([tmp_path / "empty", "--mask2former", mask2former], "expected a rollout with generated images, found none"),
    ):
        assert main(list(map(str, arguments))) == 1
        last = capsys.readouterr().err.splitlines()[-1]
        assert last.startswith("pskel.metrics.masks: ") and said in last, arguments
    with pytest.raises(SystemExit):
        main([str(rollout), str(rollout), "--mask2former", str(mask2former), "--out", str(tmp_path / "out")])
    assert "expected one ROLLOUT with --out, found 2" in capsys.readouterr().err
