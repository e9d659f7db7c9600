"""Clips for StreetCrafter and FreeVS, read as their data set classes do, and by these if their sources are there.

``PSKEL_STREETCRAFTER`` and ``PSKEL_FREEVS`` are folders of the repositories zju3dv/street_crafter and esdolo/FreeVS;
without them, ``interop/streetcrafter`` and ``interop/freevs`` in ``PSKEL_SHARED`` are used.
"""

import importlib
import json
import os
import pickle
import pickletools
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pskel
import pytest

Image: Any = pytest.importorskip("PIL.Image")

TEN_HZ = "town:seed=7,frames=25,hz=10,size=40x72"
FIVE_HZ = "town:seed=7,frames=7,size=45x80"
CAMERAS = 6
SIZE = (320, 576)
SPLAT = "100:3"

Pixels = npt.NDArray[np.uint8]


@pytest.fixture(scope="module")
def skeletons(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the skeletons of both towns. The points of one frame are enough."""
    folder = tmp_path_factory.mktemp("skeletons")
    for town in (TEN_HZ, FIVE_HZ):
        log = pskel.Log(town)
        pskel.build(log, folder / log.name, frames=(0, 1))
    return folder


@pytest.fixture(scope="module")
def streetcrafter(tmp_path_factory: pytest.TempPathFactory, skeletons: Path) -> Path:
    """An export in the layout streetcrafter, in small: the size of the low-resolution network."""
    out = tmp_path_factory.mktemp("streetcrafter")
    keywords: Any = {"size": SIZE, "splat": SPLAT, "shard_frames": 9}
    report = pskel.export(TEN_HZ, out, layout="streetcrafter", skeletons=skeletons, **keywords)
    assert report["failures"] == [] and report["complete"] and report["samples"] == 25
    return out


@pytest.fixture(scope="module")
def freevs(tmp_path_factory: pytest.TempPathFactory, skeletons: Path) -> Path:
    """An export in the layout freevs."""
    out = tmp_path_factory.mktemp("freevs")
    report = pskel.export(FIVE_HZ, out, layout="freevs", skeletons=skeletons, splat="100:0", shard_frames=4)
    assert report["failures"] == [] and report["complete"] and report["samples"] == 7
    return out


def pixels(path: Path) -> Pixels:
    with Image.open(path) as image:
        return np.array(image)


def source(name: str) -> Path:
    """Folder of a repository; skips the test without it."""
    shared = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[3] / "shared"))
    folder = Path(os.environ.get(f"PSKEL_{name.upper()}", shared / "interop" / name))
    if not folder.is_dir():
        pytest.skip(f"the source of {name} is not there (set PSKEL_{name.upper()})")
    return folder


def stub(name: str, *paths: str, **attributes: object) -> None:
    """Make a package whose ``__init__`` is not run, or a module that a class imports and does not use."""
    module = types.ModuleType(name)
    module.__path__ = list(paths)
    vars(module).update(attributes)
    sys.modules[name] = module


def test_streetcrafter_clips_are_rendered_points(streetcrafter: Path, skeletons: Path) -> None:
    log, skeleton = pskel.Log(TEN_HZ), pskel.Skeleton(next(skeletons.glob("*10hz*")))
    # Without templates and with all actors' own points, depth has the points of the color cloud.
    own: Any = {"min_actor_points": 0, "default_templates": False}
    renderer = pskel.Renderer(skeleton, size=SIZE, splat=SPLAT, maps=["color", "depth"], **own)
    with_templates = pskel.Renderer(skeleton, size=SIZE, splat=SPLAT, maps=["depth"])
    clips = json.loads((streetcrafter / "meta_info_train.json").read_text())
    assert clips == json.loads((streetcrafter / "meta_info_val.json").read_text())
    assert len(clips) == CAMERAS
    differing = 0
    for number in (0, 9, 24):
        scene = log[number]
        maps = renderer.render(scene)
        other = np.isfinite(with_templates.render(scene)["depth"])
        for camera, clip in enumerate(clips):
            frame, guidance, mask = (
                pixels(streetcrafter / clip[key][number]) for key in ("frames", "guidances", "guidances_mask")
            )
            np.testing.assert_array_equal(guidance, maps["color"][camera])
            assert frame.shape == guidance.shape == (*SIZE, 3) and len(np.unique(frame)) > 16
            seen = np.isfinite(maps["depth"][camera])
            np.testing.assert_array_equal(mask, np.where(seen, 255, 0))
            assert 0 < seen.sum() < seen.size
            differing += int((seen != other[camera]).sum())
    assert differing > 0  # masks of the geometry cloud would be wrong


def test_clips_are_read_by_streetcrafter(streetcrafter: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch")
    pytest.importorskip("torchvision")
    vwm = source("streetcrafter") / "video_diffusion" / "vwm"
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    # The packages themselves import the network.
    for name, folder in [("vwm", vwm), ("vwm.data", vwm / "data"), ("vwm.data.subsets", vwm / "data" / "subsets")]:
        stub(name, str(folder))
    waymo = importlib.import_module("vwm.data.subsets.waymo").WaymoDataset
    pandaset = importlib.import_module("vwm.data.subsets.pandaset").PandasetDataset
    height, width = SIZE
    for split, name in [("train", "train"), ("val", "val"), ("test", "val")]:
        clips = json.loads((streetcrafter / f"meta_info_{name}.json").read_text())
        for dataset_class in (waymo, pandaset):
            dataset = dataset_class(
                data_root=str(streetcrafter), target_height=height, target_width=width, num_frames=25, split=split
            )
            assert len(dataset) == len(clips) == CAMERAS
            sample = dataset[2]
            for key, paths in [("img_seq", "frames"), ("guide_seq", "guidances")]:
                assert sample[key].shape == (25, 3, height, width)
                for number in (0, 24):
                    expected = torch.from_numpy(pixels(streetcrafter / clips[2][paths][number])).permute(2, 0, 1)
                    assert torch.equal(sample[key][number], expected.float() / 255 * 2 - 1), (key, number)
    mask = torch.from_numpy(pixels(streetcrafter / clips[2]["guidances_mask"][24]))
    assert torch.equal(sample["guide_mask_seq"][24].squeeze(), mask.float() / 255 * 2 - 1)


def test_the_list_of_freevs_is_a_pickle_of_paths(freevs: Path) -> None:
    stored = (freevs / "freevs.pkl").read_bytes()
    operations = {operation.name for operation, _, _ in pickletools.genops(stored)}
    assert operations == {
        "PROTO", "EMPTY_DICT", "MARK", "BINUNICODE", "EMPTY_LIST", "SETITEMS", "APPENDS", "STOP"
    }  # fmt: skip
    sequences: dict[str, list[dict[str, str]]] = pickle.loads(stored)
    log = pskel.Log(FIVE_HZ)
    name = log.name
    assert sorted(sequences) == sorted(f"{name}_{camera}" for camera in log[0].cameras)
    assert sum(key.endswith("FRONT") for key in sequences) == 1  # --front_only
    for index, camera in enumerate(log[0].cameras):
        views = sequences[f"{name}_{camera}"]
        assert [view["image"] for view in views] == [
            f"gt/{name}/{1 + CAMERAS * number + index:04}_{name}_{2 * number}_{camera}.jpg" for number in range(7)
        ]
        for view in views:
            points = view["pseudo_image"]
            # The loader's rule: the name without its first five characters.
            assert Path(points).name == Path(view["image"]).name[5:]
            assert set(view) == {"image", "pseudo_image", "pseudo_image_minusframe", "pseudo_image_plusframe"}
            assert {view["pseudo_image_minusframe"], view["pseudo_image_plusframe"]} == {points}
            for path in (view["image"], points):
                with Image.open(freevs / path) as image:
                    assert (image.format, image.size, image.mode) == ("JPEG", (960, 384), "RGB")


def test_clips_are_read_by_freevs(freevs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch")
    transforms: Any = pytest.importorskip("torchvision.transforms")
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    monkeypatch.syspath_prepend(str(source("freevs") / "diffusers" / "examples" / "freevs"))
    # Modules that are imported and not used.
    for name in ("nuscenes", "nuscenes.eval", "nuscenes.eval.common", "cv2"):
        stub(name)
    stub("nuscenes.eval.common.utils", quaternion_yaw=None, Quaternion=None)
    stub("ipdb", set_trace=None)
    dataset_class = importlib.import_module("utils.video_datasets").VideoNuscenesDataset
    monkeypatch.chdir(freevs)
    sequences = pickle.loads((freevs / "freevs.pkl").read_bytes())
    to_tensor = transforms.Compose([transforms.ToTensor(), transforms.Normalize([0.5], [0.5])])
    for ratio in (0.0, 1.0):  # without and with the points of other times
        dataset = dataset_class(
            data_root="freevs.pkl", video_length=7, tokenizer=None, mismatch_aug_ratio=ratio, video_transforms=to_tensor
        )
        assert len(dataset) == CAMERAS
        read = [dataset[index] for index in range(len(dataset))]
        for sample, views in zip(read, sequences.values(), strict=True):
            assert sample["pixel_values"].shape == sample["pseudo_pixel_values"].shape == (7, 3, 384, 960)
            for key, path in [("pixel_values", "image"), ("pseudo_pixel_values", "pseudo_image")]:
                expected = torch.from_numpy(pixels(freevs / views[6][path])).permute(2, 0, 1)
                assert torch.equal(sample[key][6], (expected.float() / 255 - 0.5) / 0.5), key


def test_unsuited_rates_and_sizes_are_refused(tmp_path: Path, skeletons: Path) -> None:
    refused: list[tuple[dict[str, Any], str]] = [
        ({"layout": "streetcrafter", "hz": 2}, "expected samples at 10 Hz"),
        ({"layout": "streetcrafter", "out_size": (576, 1024)}, "expected --size alone"),
        ({"layout": "freevs", "between_images": True}, "found images between key frames"),
        ({"layout": "frames", "validation_logs": ["a"]}, "expected the layout streetcrafter"),
    ]
    for options, message in refused:
        with pytest.raises(ValueError, match=message):
            pskel.export(FIVE_HZ, tmp_path / "out", skeletons=skeletons, **options)
    assert not (tmp_path / "out").exists()
    with pytest.raises(pskel.Error, match="for the validation split, found nobody"):
        pskel.export(TEN_HZ, tmp_path / "out", layout="streetcrafter", skeletons=skeletons, validation_logs=["nobody"])
