"""The usual readers of other projects get the values of the maps."""

import io
import os
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from conftest import TOWN, Run

os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"
MAPS = "color,depth,class,instance,boxes,point"


@pytest.fixture
def rendered(skeleton: pskel.Skeleton, tmp_path: Path, run: Run) -> Any:
    """Renders the first frame in a format, and returns the folder of its first camera."""

    def render(format: str) -> Path:
        out = tmp_path / format
        # Numbers of points do not fit into a PNG.
        maps = MAPS.replace(",point", "") if format == "png" else MAPS
        common = ["--rasterizer", "cpu", "--frames", "0..1", "--out-size", "56x100", "--maps", maps]
        run("-m", "pskel", "render", TOWN, "--skeleton", str(skeleton.path), "--format", format, "--out", str(out), *common)
        if format == "npz":
            return out / "000000"
        return min(path for path in (out / "000000").iterdir() if path.is_dir())

    return render


@pytest.fixture
def expected(rendered: Any, tmp_path: Path) -> dict[str, Any]:
    """The arrays of the first camera by name."""
    import json

    folder = rendered("npz")
    with np.load(folder / "maps.npz") as arrays:
        cameras = [camera["name"] for camera in json.loads((folder / "meta.json").read_text())["cameras"]]
        index = cameras.index(min(cameras))
        return {name: arrays[name][index] for name in arrays.files}


def test_opencv_reads_exr_files(rendered: Any, expected: dict[str, Any]) -> None:
    cv2 = pytest.importorskip("cv2")
    folder = rendered("exr")
    for name, array in expected.items():
        found = cv2.imread(str(folder / f"{name}.exr"), cv2.IMREAD_UNCHANGED)
        assert found is not None, name
        if array.ndim == 3:
            np.testing.assert_array_equal(np.rint(found[..., ::-1] * 255).astype(np.uint8), array, name)
        else:
            np.testing.assert_array_equal(found, array.astype(np.float32), name)
    assert len(np.unique(expected["depth"])) > 100 and expected["instance"].max() > 0


def test_openexr_reads_exr_files(rendered: Any, expected: dict[str, Any]) -> None:
    openexr = pytest.importorskip("OpenEXR")
    folder = rendered("exr")
    for name, channel in (("depth", "Z"), ("class", "class"), ("instance", "instance"), ("point", "point")):
        channels = openexr.File(str(folder / f"{name}.exr")).channels()
        for found in (channel, "Y"):
            np.testing.assert_array_equal(channels[found].pixels, expected[name], f"{name} {found}")


def test_pillow_and_opencv_read_png_files(rendered: Any, expected: dict[str, Any]) -> None:
    image = pytest.importorskip("PIL.Image")
    cv2 = pytest.importorskip("cv2")
    folder = rendered("png")
    for name, array in expected.items():
        if name == "point":
            continue
        path = str(folder / f"{name}.png")
        found = np.asarray(image.open(path))
        other = cv2.imread(path, cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(other[..., ::-1] if array.ndim == 3 else other, found, name)
        if name == "depth":
            assert found.dtype == np.uint16 and len(np.unique(found)) > 20
            continue
        np.testing.assert_array_equal(found, array, name)


@pytest.mark.parametrize("decoder", ["rgb8", "rgb", "pil", "torchrgb", "l8", None])
def test_decoders_of_webdataset_keep_all_values(
    tmp_path: Path, skeleton: pskel.Skeleton, decoder: str | None
) -> None:
    webdataset = pytest.importorskip("webdataset")
    image = pytest.importorskip("PIL.Image")
    if decoder == "torchrgb":
        pytest.importorskip("torch")
    maps = ["color", "depth", "class", "instance"]
    pskel.export(TOWN, tmp_path, layout="webdataset", skeletons=tmp_path / "sk", out_size=(56, 100), maps=maps)
    shard = next(tmp_path.glob("*.tar"))
    dataset = webdataset.WebDataset([str(shard)], shardshuffle=False)
    sample = next(iter(dataset.decode(decoder) if decoder else dataset.decode()))
    with tarfile.open(shard) as tar:
        key = sample["__key__"]
        raw = {m.name.removeprefix(f"{key}."): tar.extractfile(m) for m in tar.getmembers() if m.name.startswith(f"{key}.")}
        files = {name: file.read() for name, file in raw.items() if file is not None}
    arrays = [name for name in files if name.endswith(".npy")]
    assert {name.split(".")[0] for name in arrays} == {"depth", "instance"}
    for name in arrays:
        true = np.load(io.BytesIO(files[name]))
        assert true.dtype == np.uint16 and true.shape == (56, 100)
        np.testing.assert_array_equal(sample[name], true, name)
    depth = sample["depth.cam_front.npy"]
    assert len(np.unique(depth)) > 20
    # As the documentation does.
    depth_m = (depth // (65535 // 256) - 0.5) * (100 / 255)
    renderer = pskel.Renderer(skeleton, out_size=(56, 100), maps=["depth"], rasterizer="cpu")
    log = pskel.Log(TOWN)
    true_m = renderer.render(log[0])["depth"][log[0].cameras.index("CAM_FRONT")]
    seen = depth > 0
    np.testing.assert_array_equal(seen, np.isfinite(true_m))
    assert np.abs(depth_m[seen] - true_m[seen]).max() < 0.2
    # No image of more than 8 bits is left to the decoders.
    for name in (name for name in files if name.endswith(".png")):
        assert image.open(io.BytesIO(files[name])).mode in ("L", "RGB"), name
