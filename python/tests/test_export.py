"""Exports, read by the programs that they are for."""

import hashlib
import importlib.util
import json
import os
import sys
import tarfile
import types
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from conftest import TOWN


@pytest.fixture(scope="module")
def skeletons(skeleton: pskel.Skeleton, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the skeleton of the town under its name in exports."""
    folder = tmp_path_factory.mktemp("skeletons")
    name = shard_names(folder)[0].rsplit("-", 1)[0]
    (folder / name).symlink_to(skeleton.path)
    return folder


def listed(out: Path, skeletons: Path, **options: Any) -> Any:
    from pskel._export import defaults
    from pskel._pskel import Export

    return Export([TOWN], out, {**defaults(), **options, "skeletons": skeletons})


def shard_names(folder: Path) -> list[str]:
    job = listed(folder / "none", folder, layout="frames")
    return [name for name, _, _, _ in job.shards]


def export(out: Path, skeletons: Path, layout: str, **options: Any) -> pskel.ExportReport:
    report = pskel.export(TOWN, out, layout=layout, skeletons=skeletons, **{"out_size": (56, 100), **options})
    assert report["failures"] == [] and report["complete"]
    return report


def test_shards_are_what_webdataset_reads(tmp_path: Path, skeletons: Path, renderer: pskel.Renderer, log: pskel.Log) -> None:
    webdataset = pytest.importorskip("webdataset")
    report = export(tmp_path, skeletons, "webdataset", images=True, shard_frames=2, maps=["color", "depth", "boxes"])
    assert (report["written"], report["samples"]) == (2, 4)
    urls = [entry["url"] for entry in json.loads((tmp_path / "index.json").read_text())["shardlist"]]
    dataset = webdataset.WebDataset([str(tmp_path / url) for url in urls], shardshuffle=False).decode("rgb8")
    samples = list(dataset)
    assert len(samples) == len(log)
    for sample, scene in zip(samples, (log[i] for i in range(len(log))), strict=True):
        maps = renderer.render(scene)
        for camera, info in enumerate(sample["json"]["cameras"]):
            color = sample[f"color.{info['name'].lower()}.png"]
            np.testing.assert_array_equal(color, maps["color"][camera])
            assert sample[f"image.{info['name'].lower()}.jpg"].shape == (56, 100, 3)
        cameras = sample["json"]["cameras"]
        np.testing.assert_allclose([c["camera_from_global"] for c in cameras], scene.camera_from_global, rtol=1e-12)


def test_given_shards_have_no_index_of_their_own(tmp_path: Path, skeletons: Path) -> None:
    """A task that writes the shards of one log does not know the shards of other logs."""
    job = listed(tmp_path, skeletons, layout="webdataset", shard_frames=2, out_size=(56, 100))
    names = [name for name, _, _, _ in job.shards]
    job.run(names)
    assert not (tmp_path / "index.json").exists()
    assert job.write_index(tmp_path)
    index = json.loads((tmp_path / "index.json").read_text())
    assert [entry["url"] for entry in index["shardlist"]] == [f"{name}.tar" for name in names]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["export.json", "index.json", "shards", *(f"{name}.tar" for name in names)]
    )


def test_safetensors_in_shards_equal_rendered_maps(
    tmp_path: Path, skeletons: Path, renderer: pskel.Renderer, log: pskel.Log
) -> None:
    safetensors = pytest.importorskip("safetensors.numpy")
    export(tmp_path, skeletons, "webdataset", format="safetensors")
    with tarfile.open(next(tmp_path.glob("*.tar"))) as tar:
        names = [name for name in tar.getnames() if name.endswith(".conditions.safetensors")]
        files = [tar.extractfile(name) for name in names]
        arrays = [safetensors.load(file.read()) for file in files if file is not None]
    assert len(arrays) == len(log)
    for found, scene in zip(arrays, (log[i] for i in range(len(log))), strict=True):
        maps: dict[str, Any] = dict(renderer.render(scene))
        maps["depth"] = np.where(np.isinf(maps["depth"]), -300, maps["depth"])
        for name in ["color", "depth", "class", "instance", "boxes", "map"]:
            np.testing.assert_array_equal(found[name], maps[name], name)


def test_packages_load_in_opendwm(tmp_path: Path, skeletons: Path, log: pskel.Log) -> None:
    torch = pytest.importorskip("torch")
    shared = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[3] / "shared"))
    source = shared / "interop" / "opendwm" / "preview.py"
    if not source.exists():
        pytest.skip("OpenDWM's preview.py is not there (set PSKEL_SHARED)")
    export(tmp_path, skeletons, "opendwm-preview", images=True)
    # The module imports a helper of its package for resampling in time, which strides of frames do not use.
    modules = ["dwm", "dwm.common", "dwm.datasets", "dwm.datasets.common"]
    sys.modules.update({name: types.ModuleType(name) for name in modules})
    sys.modules["dwm"].common = sys.modules["dwm.common"]  # type: ignore[attr-defined]
    sys.modules["dwm"].datasets = sys.modules["dwm.datasets"]  # type: ignore[attr-defined]
    spec = importlib.util.spec_from_file_location("preview", source)
    assert spec is not None and spec.loader is not None
    preview = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(preview)
    scene = log[1]
    channels = list(scene.cameras)
    package = next(tmp_path.glob("*/data.json"))
    dataset = preview.PreviewDataset(str(package), 2, [(0, 1)], channels, enable_camera_transforms=True)
    assert len(dataset) == 3
    item = dataset[1]
    assert [image.size for image in item["3dbox_images"][0]] == [(100, 56)] * len(channels)
    assert [image.size for image in item["images"][0]] == [(100, 56)] * len(channels)
    np.testing.assert_allclose(item["ego_transforms"][0, 0], scene.ego.astype(np.float32))
    camera_from_global = np.linalg.inv(item["ego_transforms"][0].double() @ item["camera_transforms"][0].double())
    # Cameras have their own ego poses, up to 0.1 s before the frame's; single precision at city coordinates.
    np.testing.assert_allclose(camera_from_global[:, :3, :3], scene.camera_from_global[:, :3, :3], atol=0.05)
    assert torch.equal(item["image_size"][0, 0], torch.tensor([56, 100]))


def test_parquet_files_have_the_documented_schema(tmp_path: Path, skeletons: Path, log: pskel.Log) -> None:
    pa: Any = pytest.importorskip("pyarrow")
    pq: Any = pytest.importorskip("pyarrow.parquet")
    export(tmp_path, skeletons, "world-scenario", out_size=None)
    clip = next(path for path in tmp_path.iterdir() if path.is_dir() and path.name != "shards")
    tables = {path.name.split(".")[1]: pq.read_table(path) for path in clip.iterdir()}
    text, number = pa.string(), pa.float64()
    xyz = pa.struct([(axis, number) for axis in "xyz"])
    xyzw = pa.struct([(axis, number) for axis in "xyzw"])
    line = pa.list_(xyz)
    time_key = [("clip_id", text), ("timestamp_micros", pa.int64())]
    map_key = [(name, text) for name in ["clip_id", "label_class_id", "map_id", "map_id_version"]]
    obstacle = [
        ("trackline_id", text), ("center", xyz), ("size", xyz), ("orientation", xyzw), ("category", text),
    ]  # fmt: skip
    place = [("category", text), ("location", line)]
    expected = {
        "obstacle": ([*time_key, ("label_class_id", text)], obstacle),
        "calibration_estimate": (time_key, [("name", text), ("rig_json", text)]),
        "egomotion_estimate": (time_key, [("name", text), ("location", xyz), ("orientation", xyzw)]),
        "lane_line": (map_key, [("line_rail", line), ("styles", pa.list_(text)), ("colors", pa.list_(text))]),
        "road_boundary": (map_key, place),
        "crosswalk": (map_key, place),
        "wait_line": (map_key, [*place, ("is_implicit", pa.bool_()), ("intersection_subtype", text)]),
    }
    for kind, (key, fields) in expected.items():
        if kind not in tables:
            assert kind in {"wait_line", "lane_line", "crosswalk"}, kind
            continue
        found = tables[kind].schema
        assert found.names == ["key", kind, "version"] and found.field("version").type == pa.uint64()
        for part, types_ in [("key", key), (kind, fields)]:
            inner = found.field(part).type
            assert [inner.field(i).name for i in range(inner.num_fields)] == [name for name, _ in types_], kind
            for index, (name, wanted) in enumerate(types_):
                assert _plain(pa, inner.field(index).type) == _plain(pa, wanted), f"{kind}.{part}.{name}"
    assert set(expected) >= set(tables) >= {"obstacle", "calibration_estimate", "egomotion_estimate", "road_boundary"}
    boxes = tables["obstacle"].to_pylist()
    assert len(boxes) == sum(len(log[i].actors) for i in range(len(log)))
    first = log[0]
    actor = first.actors[0]
    center = np.linalg.inv(first.ego) @ actor.global_from_box[:, 3]
    assert [boxes[0]["obstacle"]["center"][axis] for axis in "xyz"] == pytest.approx(center[:3], abs=1e-6)
    assert boxes[0]["obstacle"]["trackline_id"] == actor.track
    ego = tables["egomotion_estimate"].to_pylist()
    assert ego[0]["egomotion_estimate"]["location"]["x"] == pytest.approx(0, abs=1e-9)
    rig = json.loads(tables["calibration_estimate"].to_pylist()[0]["calibration_estimate"]["rig_json"])
    assert {sensor["properties"]["Model"] for sensor in rig["rig"]["sensors"]} == {"ftheta"}


def _plain(pa: Any, kind: Any) -> Any:
    """A type without the names of list elements and without nullability."""
    if pa.types.is_list(kind):
        return pa.list_(_plain(pa, kind.value_type))
    if pa.types.is_struct(kind):
        return pa.struct([(kind.field(i).name, _plain(pa, kind.field(i).type)) for i in range(kind.num_fields)])
    return kind


def test_videos_have_all_cameras(tmp_path: Path, skeletons: Path) -> None:
    report = export(tmp_path, skeletons, "cosmos-video", images=True, hz=10)
    assert report["samples"] > 4
    folders = sorted(path.name for path in (tmp_path / "videos").iterdir())
    assert "ftheta_camera_front_wide_120fov" in folders and len(folders) == 6
    for kind in ["videos", "control_input_hdmap_bbox", "control_input_color"]:
        for folder in folders:
            video = next((tmp_path / kind / folder).glob("*.mp4")).read_bytes()
            assert video[4:8] == b"ftyp" and b"avcC" in video
    caption = next((tmp_path / "captions" / folders[0]).glob("*.json"))
    assert set(json.loads(caption.read_text())) == {"caption"}


def test_options_and_folders_are_checked(tmp_path: Path, skeletons: Path) -> None:
    with pytest.raises(ValueError, match=r"^expected layout to be one of frames, pas-cache, .*, found \"mosaic\"\Z"):
        pskel.export(TOWN, tmp_path, layout="mosaic", skeletons=skeletons)
    with pytest.raises(TypeError, match="unexpected keyword argument 'colour'"):
        pskel.export(TOWN, tmp_path, layout="frames", skeletons=skeletons, colour="red")  # type: ignore[call-arg]
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(pskel.Error, match="an export or an empty folder"):
        pskel.export(TOWN, tmp_path, layout="frames", skeletons=skeletons)
    report = pskel.export("nuscenes:/nowhere", tmp_path / "out", layout="frames", skeletons=skeletons)
    assert [failure["name"] for failure in report["failures"]] == ["nuscenes:/nowhere"] and not report["complete"]


def test_the_progress_counts_frames(tmp_path: Path, skeletons: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("tqdm")
    export(tmp_path, skeletons, "webdataset", progress=True)
    assert "4/4" in capfd.readouterr().err
    checksums = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in tmp_path.glob("*.tar")}
    record = json.loads(next((tmp_path / "shards").glob("*.json")).read_text())
    assert {file["path"]: file["sha256"] for file in record["files"]} == checksums
