"""Clips of logs that are rendered, recorded to a cache, or read from exports of the same log."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("accelerate")
pytest.importorskip("safetensors")
if not hasattr(pskel, "Log"):
    pytest.skip("the compiled part of pskel is not installed", allow_module_level=True)
from pskel.torch import ConditionDataset  # noqa: E402
from pskel.train import Clip, ConfigError, DataError, DataOptions  # noqa: E402
from pskel.train.data.numbers import ego_motion  # noqa: E402
from pskel.train.data.recipe import complete  # noqa: E402
from pskel.train.data.rendered import RenderedReader, Variant  # noqa: E402
from pskel.train.data.sources import Data, open_data  # noqa: E402
from pskel.train.parallel import Processes  # noqa: E402
from train_base import losses, start, write_config  # noqa: E402

LOG = "town:seed=7,frames=5,size=113x200"
RECIPE = {"drawn": "56x100", "size": "28x50", "splat": "15:1,100:0", "line_width": "scaled"}
NAMES = ("color", "bins", "boxes", "map", "images", "cameras", "action", "global_from_ego", "t_us", "original_sizes")


@pytest.fixture(scope="module")
def skeletons(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the skeleton of LOG under its name."""
    folder = tmp_path_factory.mktemp("skeletons")
    log = pskel.Log(LOG)
    pskel.build(log, folder / log.name)
    return folder


@pytest.fixture(scope="module")
def log() -> pskel.Log:
    return pskel.Log(LOG)


@pytest.fixture
def cpu() -> dict[str, Any]:
    """Options that need no driver for maps."""
    return {"rasterizer": "cpu"}


def opened(spec: object, recipe: Any = RECIPE, **options: Any) -> Data:
    return open_data([str(spec)], DataOptions(**options), recipe, Processes(), lambda text: None)


def assert_equal(one: Clip, other: Clip, names: tuple[str, ...] = NAMES) -> None:
    for name in names:
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype and torch.equal(a, b), name
    assert (one.log, one.frame, one.names, one.hz) == (other.log, other.frame, other.names, other.hz)


def test_rendered_clips_are_the_maps_of_the_renderer(skeletons: Path, log: pskel.Log, cpu: dict[str, Any]) -> None:
    data = opened(LOG, frames=2, skeletons=str(skeletons), **cpu)
    assert [len(clip_set) for clip_set in data.train] == [4] and data.train[0].reader.log == log.name
    clip = data.train[0].clip(1)
    renderer = pskel.Renderer(
        pskel.Skeleton(skeletons / log.name), size=(56, 100), out_size=(28, 50), splat="15:1,100:0",
        color_filter="visible-area", line_width="scaled", maps=["color", "depth", "boxes", "map", "tensor"],
        rasterizer="cpu",
    )  # fmt: skip
    for number, frame in enumerate((1, 2)):
        maps: Any = renderer.render(log[frame])
        for name in ("color", "boxes", "map"):
            np.testing.assert_array_equal(getattr(clip, name)[number].permute(0, 2, 3, 1), maps[name])
        # The tensor has min(bin, n - 1) / (n - 1), or -1 where it is empty.
        bins = np.where(maps["points"][:, 3] < 0, 0, np.rint(maps["points"][:, 3] * 255))
        np.testing.assert_array_equal(clip.bins[number].clamp(max=255), bins)
        assert bins.max() > 100
        np.testing.assert_array_equal(clip.global_from_ego[number], log[frame].ego)
    np.testing.assert_allclose(clip.action[0], ego_motion(log[0].ego, log[1].ego), atol=1e-6)
    assert clip.t_us.tolist() == log.times_us[1:3] and clip.hz == pytest.approx(5.0)
    assert clip.original_sizes.tolist() == [[113, 200]] * 6
    # A town is rendered at the size of the maps and reduced: near the images at the size of the clip.
    images = log.images(log[1], (28, 50)).transpose(0, 3, 1, 2).astype(np.float64)
    assert np.abs(clip.images[0].numpy() - images).mean() < 8
    # Mounting positions are the same in all frames, unlike the cameras of images that were taken while moving.
    torch.testing.assert_close(clip.cameras[0], clip.cameras[1], rtol=0, atol=1e-6)
    own = np.linalg.inv(log[1].ego) @ np.linalg.inv(log[1].camera_from_global)
    assert np.abs(own[:, :3].reshape(6, 12) - clip.cameras[0, :, :12].numpy()).max() > 0.01


def test_recordings_have_the_bytes_of_rendering(skeletons: Path, tmp_path: Path, cpu: dict[str, Any]) -> None:
    options = {"frames": 2, "variants": 2, "skeletons": str(skeletons), **cpu}
    said: list[str] = []
    cached = open_data([LOG], DataOptions(cache=str(tmp_path / "cache"), **options), RECIPE, Processes(), said.append)
    assert len(said) == 2 and said[0].startswith("[1/2] recording town-7-5f")
    plain = opened(LOG, **options)
    for data in (cached, plain):
        assert [clip_set.reader.variant for clip_set in data.train] == [0, 1]
    for one, other in zip(cached.train, plain.train):
        for index in (0, 2):
            assert_equal(one.clip(index), other.clip(index))
    files = sorted((tmp_path / "cache").glob("*.safetensors"))
    before = [(path.stat().st_mtime_ns, path.stat().st_size) for path in files]
    again = open_data([LOG], DataOptions(cache=str(tmp_path / "cache"), **options), RECIPE, Processes(), said.append)
    assert len(said) == 2 and [(path.stat().st_mtime_ns, path.stat().st_size) for path in files] == before
    assert_equal(again.train[1].clip(1), plain.train[1].clip(1))
    with pytest.raises(DataError, match="found another one; remove it"):
        open_data(
            [LOG],
            DataOptions(cache=str(tmp_path / "cache"), **options),
            {**RECIPE, "drawn": "28x50"},
            Processes(),
            print,
        )


def test_recordings_have_captions(skeletons: Path, log: pskel.Log, tmp_path: Path, cpu: dict[str, Any]) -> None:
    options = {"frames": 2, "cache": str(tmp_path / "cache"), "skeletons": str(skeletons), **cpu}
    files = {"rain": {log.name: "Rain"}, "sun": {log.name: "Sun"}, "other": {"other": "Sun"}, "wrong": []}
    for name, content in files.items():
        (tmp_path / name).write_text(json.dumps(content))

    def said(name: str, **changed: Any) -> tuple[Data, list[str]]:
        texts: list[str] = []
        chosen = DataOptions(**{**options, **changed}, captions=str(tmp_path / name))
        return open_data([LOG], chosen, RECIPE, Processes(), texts.append), texts

    data, texts = said("rain")
    assert data.train[0].clip(1).captions == (("Rain",) * 6,) * 2 and "captions" not in " ".join(texts)
    # Other captions need no other maps.
    data, texts = said("sun")
    assert data.train[0].clip(1).captions == (("Sun",) * 6,) * 2 and texts == []
    assert opened(LOG, **options).train[0].clip(1).captions == (("",) * 6,) * 2
    for changed in ({"cache": None}, {"cache": str(tmp_path / "again")}):
        data, texts = said("other", **changed)
        assert texts[-1] == f"{tmp_path / 'other'}: no captions of 1 logs, such as {log.name}; theirs are empty"
        assert data.train[0].clip(1).captions == (("",) * 6,) * 2
    with pytest.raises(DataError, match="expected .*, found an array.*: .*wrong"):
        said("wrong", skeletons=str(tmp_path / "not built"))


def test_a_moved_ego_sees_its_own_images(skeletons: Path, log: pskel.Log, cpu: dict[str, Any]) -> None:
    data = opened(LOG, frames=2, variants=3, augment=False, skeletons=str(skeletons), **cpu)
    first, second = data.train[0].reader, data.train[1].reader
    assert isinstance(first, RenderedReader) and isinstance(second, RenderedReader)
    change = second.change
    assert 0 < abs(change.left_m) <= 3.5 and 0 < abs(change.yaw_rad) <= 0.1 and change.assets is None
    assert change != data.train[2].reader.change  # type: ignore[attr-defined]
    assert change == Variant.create(log.name, 1, town=True, augment=False)
    recorded, moved = data.train[0].clip(0), data.train[1].clip(0)
    scene = log[0].move_ego(left_m=change.left_m, yaw_deg=float(np.degrees(change.yaw_rad)))
    np.testing.assert_allclose(moved.global_from_ego[0], scene.ego, atol=1e-9)
    torch.testing.assert_close(moved.cameras, recorded.cameras, rtol=0, atol=1e-6)
    images = torch.from_numpy(log.images(scene, (28, 50)).transpose(0, 3, 1, 2).copy()).double()
    error = (moved.images[0].double() - images).abs().mean()
    assert error < 0.5 * (recorded.images[0].double() - images).abs().mean()
    assert not torch.equal(moved.color, recorded.color)
    # Recorded logs are not moved, but their assets are degraded.
    assert Variant.create("scene", 1, town=False, augment=True) == Variant(1, 0.0, 0.0, 0)


def test_degraded_assets_differ(skeletons: Path, cpu: dict[str, Any]) -> None:
    options = {"frames": 1, "variants": 2, "skeletons": str(skeletons), **cpu}
    whole, degraded = opened(LOG, augment=False, **options).train[1], opened(LOG, augment=True, **options).train[1]
    pairs = [(whole.clip(index), degraded.clip(index)) for index in range(5)]
    assert all(torch.equal(one.images, other.images) and torch.equal(one.boxes, other.boxes) for one, other in pairs)
    assert any(not torch.equal(one.color, other.color) for one, other in pairs)


@pytest.mark.parametrize("form", ["png", "safetensors"])
def test_shards_have_the_clips_of_rendering(skeletons: Path, tmp_path: Path, cpu: dict[str, Any], form: str) -> None:
    pytest.importorskip("PIL")
    out = tmp_path / "shards"
    report = pskel.export(
        LOG, out, layout="webdataset", skeletons=skeletons, images=True, shard_frames=2, format=form, size=(56, 100),
        out_size=(28, 50), splat="15:1,100:0", color_filter="visible-area", maps=["color", "depth", "boxes", "map"],
        rasterizer="cpu",
    )  # fmt: skip
    assert report["complete"]
    shards, rendered = opened(out, frames=3), opened(LOG, frames=3, skeletons=str(skeletons), **cpu)
    for index in range(3):
        one, other = shards.train[0].clip(index), rendered.train[0].clip(index)
        assert_equal(one, other, ("color", "bins", "boxes", "map", "t_us"))
        torch.testing.assert_close(one.cameras, other.cameras, rtol=0, atol=1e-6)
        torch.testing.assert_close(one.global_from_ego, other.global_from_ego, rtol=0, atol=1e-9)
        torch.testing.assert_close(one.action, other.action, rtol=0, atol=1e-6)
        assert torch.equal(one.original_sizes, other.original_sizes)
        assert one.captions[0][0].startswith("A drive in")


def test_a_pas_cache_has_the_maps_of_rendering(skeletons: Path, tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    out = tmp_path / "cache"
    # The size of the images, so that layouts are the same too.
    report = pskel.export(LOG, out, layout="pas-cache", skeletons=skeletons, rasterizer="cpu")
    assert report["complete"]
    with pytest.raises(DataError, match="expected a cache with --out-size"):
        opened(LOG, None, pas_cache=str(out))
    out = tmp_path / "sized"
    pskel.export(
        LOG, out, layout="pas-cache", skeletons=skeletons, rasterizer="cpu", size=(113, 200), out_size=(113, 200)
    )
    recipe = {
        "drawn": "113x200",
        "size": "113x200",
        "splat": "15:2,35:1,100:0",
        "color_filter": "bilinear",
        "line_width": "scaled",
    }
    cached = opened(LOG, recipe, frames=2, pas_cache=str(out))
    rendered = opened(LOG, recipe, frames=2, skeletons=str(skeletons), rasterizer="cpu")
    assert_equal(cached.train[0].clip(1), rendered.train[0].clip(1))
    assert opened(LOG, None, frames=2, pas_cache=str(out)).recipe == complete(recipe)
    with pytest.raises(DataError, match="expected maps with splat 15:1,100:0"):
        opened(LOG, {**recipe, "splat": "15:1,100:0"}, pas_cache=str(out))
    next((out / "proj_clr").glob("000002_*")).unlink()
    from pskel.train.data.reader import Skip

    with pytest.raises(Skip, match="not in the cache"):
        cached.train[0].clip(1)


def test_logs_that_cannot_be_trained_on(skeletons: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"expected a recipe in \[data.recipe\]"):
        opened(LOG, None, skeletons=str(skeletons))
    with pytest.raises(ConfigError, match="expected data.skeletons or data.cache"):
        opened(LOG)
    with pytest.raises(DataError, match="nowhere"):
        opened("nuscenes:/nowhere", skeletons=str(skeletons))
    with pytest.raises(DataError):
        opened("town:seeds=7", skeletons=str(skeletons))


def test_missing_skeletons_are_built(tmp_path: Path, skeletons: Path, log: pskel.Log) -> None:
    said: list[str] = []
    options = DataOptions(frames=1, skeletons=str(tmp_path / "new"), rasterizer="cpu")
    found = open_data([LOG], options, RECIPE, Processes(), said.append)
    assert said == [f"[1/1] building the skeleton of {log.name}"]
    (clip_set,) = opened(LOG, frames=1, skeletons=str(skeletons), rasterizer="cpu").train
    assert_equal(found.train[0].clip(3), clip_set.clip(3))


def test_a_training_on_a_town(tmp_path: Path, skeletons: Path) -> None:
    """Rendered on the fly by workers, and from a cache: the same losses."""
    found = []
    for workers, cache in ((2, None), (0, tmp_path / "cache")):
        data = {"recipe": RECIPE, "skeletons": str(skeletons), "variants": 2, "rasterizer": "cpu", "hold_out": 2}
        if cache is not None:
            data["cache"] = str(cache)
        file = write_config(tmp_path / "config.toml", train={"workers": workers, "steps": 3}, data=data)
        out = tmp_path / f"out-{workers}"
        # In a process of its own: workers are forked, and this one has opened devices.
        process = start("-m", "pskel.train", file, "--data", LOG, "--out", out)
        assert process.wait(300) == 0, process.communicate()[1]
        found.append((out / "loss.csv").read_bytes())
        assert len(losses(out)) == 3 and (out / "validation" / "3.png").is_file()
    assert found[0] == found[1]


def captions(log: str, frame: int, camera: str) -> str:
    return f"{log} {frame} {camera}"


def moved(scene: pskel.Scene, rng: np.random.Generator) -> pskel.Scene:
    return scene.move_ego(left_m=float(rng.uniform(1, 2)))


@pytest.fixture
def sources(skeletons: Path, log: pskel.Log) -> Iterator[list[tuple[str, str]]]:
    yield [(LOG, str(skeletons / log.name))]


def test_datasets_have_numbers_and_captions(sources: list[tuple[str, str]], log: pskel.Log) -> None:
    options: Any = {"out_size": (28, 50), "frames": 2, "every": 2, "images": False, "rasterizer": "cpu"}
    item = ConditionDataset(sources, numbers=True, captions=captions, **options)[2]  # frames 2 and 4
    assert item["t_us"].tolist() == [log.times_us[2], log.times_us[4]]
    assert item["cameras"].shape == (2, 6, 16) and item["cameras"].dtype == torch.float32
    assert item["action"].shape == (2, 3) and item["action"].dtype == torch.float32
    poses = [log[frame].ego for frame in (0, 2, 4)]
    np.testing.assert_array_equal(item["action"], [ego_motion(poses[0], poses[1]), ego_motion(poses[1], poses[2])])
    assert item["captions"][1][:2] == [f"{log.name} 4 CAM_FRONT", f"{log.name} 4 CAM_FRONT_RIGHT"]
    first = ConditionDataset(sources, numbers=True, **options)[0]
    assert first["action"][0].tolist() == [0, 0, 0] and "captions" not in first
    # The front camera looks ahead: its z axis is the ego's x axis, and its x axis points to the right.
    np.testing.assert_allclose(first["cameras"][0, 0, [2, 4, 9]], [1, -1, -1], atol=1e-6)
    k = log[0].intrinsics[0]
    shares = [k[0, 0] / 200, k[1, 1] / 113, k[0, 2] / 200, k[1, 2] / 113]
    np.testing.assert_allclose(first["cameras"][0, 0, 12:], shares, rtol=1e-6)
    assert set(ConditionDataset(sources, **options)[0]) == set(item) - {"cameras", "action", "captions"}


def test_numbers_of_a_moved_ego(sources: list[tuple[str, str]]) -> None:
    options: Any = {"out_size": (28, 50), "frames": 2, "images": False, "rasterizer": "cpu", "numbers": True}
    still = ConditionDataset(sources, **options)[1]
    aside = ConditionDataset(sources, augment=moved, seed=3, **options)[1]
    torch.testing.assert_close(aside["action"], still["action"], rtol=0, atol=2e-3)  # moved as one
    assert torch.allclose(aside["cameras"], still["cameras"], atol=1e-6)
    off = np.linalg.inv(still["global_from_ego"][0].numpy()) @ aside["global_from_ego"][0].numpy()
    assert 1 <= off[1, 3] <= 2


def test_datasets_with_workers_and_degraded_assets(sources: list[tuple[str, str]]) -> None:
    from torch.utils.data import DataLoader

    options: Any = {"out_size": (28, 50), "images": False, "rasterizer": "cpu", "numbers": True}
    dataset = ConditionDataset(sources, captions=captions, augment_assets=5, **options)
    one: Any = DataLoader(dataset, batch_size=None)
    two: Any = DataLoader(dataset, batch_size=None, num_workers=2, multiprocessing_context="spawn")
    for a, b in zip(one, two, strict=True):
        assert a["captions"] == b["captions"] and a["captions"][0][0].endswith("CAM_FRONT")
        assert all(torch.equal(a[name], b[name]) for name in ("points", "cameras", "action"))
    whole = ConditionDataset(sources, **options)
    assert any(not torch.equal(whole[i]["points"], dataset[i]["points"]) for i in range(len(whole)))
    assert all(torch.equal(whole[i]["layout"], dataset[i]["layout"]) for i in range(len(whole)))


def test_a_log_without_an_hd_map_has_a_black_map(tmp_path: Path, skeletons: Path) -> None:
    """A copy of the town in the layout of nuScenes, without its map files."""
    from pskel._pskel import run_command

    data = tmp_path / "data"
    assert run_command(["pskel", "town", "seed=7,frames=3,size=57x100", "--out", str(data)]) == 0
    for path in (data / "maps" / "expansion").glob("*.json"):
        path.unlink()
    (version,) = [path for path in data.iterdir() if (path / "map.json").is_file()]
    text = f"nuscenes:{data}"
    try:
        name = pskel.Log(text).name
    except pskel.Error:
        pytest.skip("the copy needs its map")
    folder = tmp_path / "skeletons"
    pskel.build(pskel.Log(text), folder / name)
    clip = opened(text, frames=1, skeletons=str(folder), rasterizer="cpu").train[0].clip(0)
    assert not clip.map.any() and clip.boxes.any() and clip.images.any()
    # The copy has the tokens of its images in its tables.
    tables = json.loads((version / "sample_data.json").read_text())
    log = pskel.Log(text)
    known = {row["token"] for row in tables if row["is_key_frame"]}
    assert len(log.image_tokens) == 3 and all(set(frame.values()) <= known for frame in log.image_tokens)
    assert all(set(frame) == set(log[0].cameras) for frame in log.image_tokens)
    scenes = json.loads((version / "scene.json").read_text())
    assert [row["token"] for row in scenes] == [log.token] and log.location
