"""Clips of recordings and of shards, and which clips are drawn."""

import json
import math
import os
import pickle
import resource
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("safetensors")
from pskel.train import Clip, ConfigError, DataError, DataOptions  # noqa: E402
from pskel.train.data.reader import ClipSet, Skip  # noqa: E402
from pskel.train.data.numbers import camera_numbers, ego_motion, joined, moved_by  # noqa: E402
from pskel.train.data.recipe import complete, depth_bins, difference, renderer_keywords  # noqa: E402
from pskel.train.data.recorded import RecordedReader, Recorder  # noqa: E402
from pskel.train.data.sampling import Sampler  # noqa: E402
from pskel.train.data.shards import shard_readers  # noqa: E402
from pskel.train.data.sources import Data, open_data  # noqa: E402
from pskel.train.parallel import Processes  # noqa: E402
from train_base import RECIPE, SIZE, write_recording  # noqa: E402
from train_shards import CAMERAS, ORIGINAL, ego, maps_of, write_export  # noqa: E402
from train_shards import RECIPE as OF_EXPORT  # noqa: E402
from train_shards import SIZE as OF_SHARDS  # noqa: E402


def opened(*specs: Path, recipe: Any = None, say: Any = lambda text: None, **options: Any) -> Data:
    return open_data([str(spec) for spec in specs], DataOptions(**options), recipe, Processes(), say)


def rgb(array: Any) -> Any:
    """``[.., H, W, 3]`` as ``[.., 3, H, W]``."""
    return torch.from_numpy(np.moveaxis(array, -1, -3).copy())


def test_windows_of_recordings_are_their_arrays(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    arrays = write_recording(path, 9, hz=4.0)
    clip_set = ClipSet.create(RecordedReader(path), frames=3, every=2, stride=2, cameras=["CAM_BACK", "CAM_FRONT"])
    assert len(clip_set) == 3
    clip = clip_set.clip(1)
    frames, views = [2, 4, 6], [1, 0]
    for name, stored in (("color", "color"), ("boxes", "boxes"), ("map", "map"), ("images", "truth")):
        found = getattr(clip, name)
        assert found.dtype == torch.uint8 and torch.equal(found, rgb(arrays[stored][frames][:, views])), name
    assert clip.bins.dtype == torch.int16 and clip.bins.tolist() == arrays["bins"][frames][:, views].tolist()
    assert clip.bins.max() == 256
    assert torch.equal(clip.cameras, torch.from_numpy(arrays["cameras"][frames][:, views]))
    for number, frame in enumerate(frames):
        both = joined(arrays["action"][frame - 1], arrays["action"][frame])
        np.testing.assert_array_equal(clip.action[number], both)
    assert clip.t_us.tolist() == [500_000, 1_000_000, 1_500_000] and clip.hz == pytest.approx(2.0)
    assert (clip.log, clip.frame, clip.names) == ("log", 2, ("CAM_BACK", "CAM_FRONT"))
    assert clip.captions == (("", ""),) * 3 and clip.original_sizes.tolist() == [list(SIZE)] * 2
    assert clip.recipe == RECIPE
    # Poses are relative to the first frame of the log, and their differences are the motions.
    for a, b, motion in zip(clip.global_from_ego, clip.global_from_ego[1:], clip.action[1:]):
        np.testing.assert_allclose(ego_motion(a.numpy(), b.numpy()), motion, atol=1e-5)
    first = clip_set.clip(0)
    assert first.frame == 0 and first.action[0].tolist() == [0, 0, 0]
    again = pickle.loads(pickle.dumps(clip_set)).clip(1)
    assert torch.equal(again.color, clip.color)


def test_held_out_frames_add_to_the_next_motion(tmp_path: Path) -> None:
    """A quarter turn to the left in every frame: forward, then left, then backward. Calculated by hand."""
    turn = math.pi / 2
    action = np.array([[0, 0, 0]] + [[1, 0, turn]] * 5, np.float32)
    path = tmp_path / "a.safetensors"
    write_recording(path, 6, changed={"action": action})
    reader = RecordedReader(path)
    kept = ClipSet.create(reader, frames=3, hold_out=2)
    assert kept.runs == ((0, 2, 4),) and len(kept) == 1
    expected: Any = [[0, 0, 0], [1, 1, 2 * turn], [1, 1, 2 * turn]]
    np.testing.assert_allclose(kept.clip(0).action, expected, atol=1e-6)
    third = ClipSet.create(reader, frames=4, hold_out=3)
    assert third.runs == ((0, 1, 3, 4),)
    expected = [[0, 0, 0], [1, 0, turn], [1, 1, 2 * turn], [1, 0, turn]]
    np.testing.assert_allclose(third.clip(0).action, expected, atol=1e-6)
    held = ClipSet.create(reader, frames=2, hold_out=2, held_out=True)
    assert held.runs == ((1, 3, 5),) and len(held) == 2
    clip = held.clip(1)
    assert clip.frame == 3
    np.testing.assert_allclose(clip.action, [[1, 1, 2 * turn]] * 2, atol=1e-6)
    # No clip of the training has a held-out frame, and no held-out clip one of the training.
    assert not {f for run in kept.runs for f in run} & {f for run in held.runs for f in run}


def test_recorders_write_what_is_read(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.safetensors"
    source = write_recording(tmp_path / "old.safetensors", 4)
    about = {"log": "town", "source": "x", "hz": 5.0, "cameras": ["A", "B"], "recipe": RECIPE}
    clip = {"variant": 2, "identity": "id", "captions": [[f"{f} a", f"{f} b"] for f in range(4)]}
    poses = np.stack([moved_by(np.eye(4), [float(frame), 0.5, 0.1 * frame]) for frame in range(4)])
    with Recorder(path, about, clip, 4) as recorder:
        for frame in range(4):
            for name in ("color", "boxes", "map", "truth", "bins", "cameras", "action"):
                recorder.write(name, source[name][frame], frame)
            recorder.write("global_from_ego", poses[frame], frame)
        recorder.write("t_us", np.array([5, 205_005, 405_005, 605_005]))
        recorder.write("original_sizes", np.array([[90, 160], [91, 161]]))
        assert not path.exists()
    assert [each.name for each in path.parent.iterdir()] == ["a.safetensors"]
    from safetensors import safe_open

    with safe_open(path, "np") as file:  # another reader
        for name, array in source.items():
            np.testing.assert_array_equal(file.get_tensor(name), array)
    reader = RecordedReader(path)
    assert (reader.log, reader.variant, reader.identity, reader.label) == ("town", 2, "id", "town-2")
    found = ClipSet.create(reader, frames=2, every=2).clip(1)
    assert found.t_us.tolist() == [205_005, 605_005] and found.original_sizes.tolist() == [[90, 160], [91, 161]]
    assert found.captions == (("1 a", "1 b"), ("3 a", "3 b"))
    np.testing.assert_array_equal(found.global_from_ego, poses[[1, 3]])
    np.testing.assert_array_equal(found.action[1], ego_motion(poses[1], poses[3]))
    other = path.with_name("b.safetensors")
    with pytest.raises(RuntimeError), Recorder(other, about, clip, 4):
        raise RuntimeError("stopped")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))  # as on a full disk
    try:
        with pytest.raises(OSError, match="File too large"), Recorder(other, about, clip, 4):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [each.name for each in path.parent.iterdir()] == ["a.safetensors"]


def test_windows_are_read_without_the_whole_file(tmp_path: Path) -> None:
    """A file of 3.5 GB, most of it holes: reading it as a whole would take as much memory."""
    path = tmp_path / "large.safetensors"
    recipe = {**RECIPE, "drawn": "512x1024", "size": "512x1024"}
    about = {"log": "large", "source": "x", "hz": 5.0, "cameras": ["A", "B"], "recipe": recipe}
    with Recorder(path, about, {}, 240) as recorder:
        recorder.write("color", np.full((2, 512, 1024, 3), 7, np.uint8), 100)
    assert path.stat().st_size > 3.5e9
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    clip = ClipSet.create(RecordedReader(path), frames=1).clip(100)
    assert set(clip.color.flatten().tolist()) == {7} and not clip.images.any()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # KiB


def test_other_files_are_no_recordings(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"

    def refused(text: str) -> None:
        with pytest.raises(DataError, match=text) as caught:
            RecordedReader(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)

    refused("cannot be read: No such file")
    for content in (b"", b"1234567", b"x" * 100, b"\x02" + bytes(7) + b"[]", b"\x02" + bytes(7) + b"{}"):
        path.write_bytes(content)
        refused("expected a")
    write_recording(path, without=["truth"])
    refused("expected a clip with images")
    write_recording(path, without=["boxes"])
    refused("no array boxes")
    write_recording(path, changed={"bins": np.zeros((8, 2, 8, 12), np.uint8)})
    refused("bins as U8")
    write_recording(path, changed={"cameras": np.zeros((8, 2, 12), np.float32)})
    refused(r"cameras as F32 \[8, 2, 12\]")
    write_recording(path, recipe={**RECIPE, "colour": 1})
    refused("expected the keys .* in a recipe, found 'colour'")
    row = ["a", "b"]
    wrong: list[object] = [[row] * 7, [row] * 7 + [["a"]], [[*row], *[["a", 1]] * 7], ["ab"] * 8, {}]
    for captions in wrong:
        write_recording(path, captions=captions)
        refused("captions other than texts of 8 frames and 2 cameras")
    write_recording(path, captions=[row] * 8)
    assert RecordedReader(path).captions == [row] * 8
    write_recording(path)
    os.truncate(path, path.stat().st_size - 1)
    refused("cut off")
    arrays = write_recording(path)
    arrays["bins"][3, 0, 0, 0] = 257
    write_recording(path, changed={"bins": arrays["bins"]})
    with pytest.raises(DataError, match="bin 257 of 256"):
        ClipSet.create(RecordedReader(path), frames=1).clip(3)


@pytest.mark.parametrize("form", ["png", "safetensors"])
def test_clips_of_shards(tmp_path: Path, form: str) -> None:
    pytest.importorskip("PIL")
    folder = write_export(tmp_path, 7, options={"format": form})
    (reader,) = shard_readers(folder)
    assert (reader.log, reader.names, reader.runs) == ("2021.05.log", CAMERAS, [range(7)])
    assert reader.hz == pytest.approx(10.0)
    clip_set = ClipSet.create(reader, frames=3, every=2, cameras=["CAM_BACK"])
    assert len(clip_set) == 3
    clip = clip_set.clip(1)  # frames 1, 3 and 5: of two shards
    expected = [maps_of(frame, 1) for frame in (1, 3, 5)]
    for name in ("color", "boxes", "map"):
        assert torch.equal(getattr(clip, name), rgb(np.stack([each[name] for each in expected])[:, None])), name
    assert clip.bins.tolist() == np.stack([each["bins"] for each in expected])[:, None].tolist()
    levels = torch.tensor([each["image"].max() for each in expected])
    assert clip.images.shape == (3, 1, 3, *OF_SHARDS)
    assert (clip.images.to(torch.int32) - levels[:, None, None, None, None]).abs().max() <= 1  # JPEG
    assert clip.cameras.shape == (3, 1, 16)
    row = [0, 0, 1, 1.5, -1, 0, 0, 0.1, 0, -1, 0, 1.6, 0.8, 8 / 6, 0.5, 0.5]
    np.testing.assert_allclose(clip.cameras[2, 0], row, atol=1e-6)
    assert clip.t_us.tolist() == [1_100_000, 1_300_000, 1_500_000] and clip.hz == pytest.approx(5.0)
    assert clip.captions == (("frame 1 of CAM_BACK",), ("frame 3 of CAM_BACK",), ("frame 5 of CAM_BACK",))
    assert clip.original_sizes.tolist() == [list(ORIGINAL)] and clip.frame == 1
    for number, t_s in enumerate((1.1, 1.3, 1.5)):
        np.testing.assert_allclose(clip.global_from_ego[number], ego(t_s), atol=1e-9)
    step = ego_motion(ego(1.1), ego(1.3))
    expected_motions: Any = [[0, 0, 0], step, ego_motion(ego(1.3), ego(1.5))]
    np.testing.assert_allclose(clip.action, expected_motions, atol=1e-6)
    np.testing.assert_allclose(clip_set.clip(2).action[0], ego_motion(ego(1.0), ego(1.2)), atol=1e-6)
    assert difference(complete(OF_EXPORT), clip.recipe) is None
    again = pickle.loads(pickle.dumps(clip_set)).clip(1)
    assert torch.equal(again.color, clip.color)


def test_clips_do_not_span_a_missing_shard(tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    (reader,) = shard_readers(write_export(tmp_path, 11, per_shard=3, leave_out=[1]))
    assert reader.runs == [range(3), range(3, 8)]
    clip_set = ClipSet.create(reader, frames=2)
    assert len(clip_set) == 2 + 4
    # Sample 3 is frame 6, whose predecessor is not there.
    times = [clip_set.clip(i).t_us.tolist() for i in range(6)]
    assert times == [[1_000_000 + 100_000 * f, 1_100_000 + 100_000 * f] for f in (0, 1, 6, 7, 8, 9)]
    assert clip_set.clip(2).action[0].tolist() == [0, 0, 0]


def test_clips_without_an_image_are_left_out_by_name(tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    folder = write_export(tmp_path, 6, without=[(2, "image.cam_back.jpg")])
    (reader,) = shard_readers(folder)
    clip_set = ClipSet.create(reader, frames=2)
    for index in (1, 2):
        with pytest.raises(Skip, match="clips without an image of CAM_BACK, such as frame 2021.05.log-000002"):
            clip_set.clip(index)
    assert ClipSet.create(reader, frames=2, cameras=["CAM_FRONT"]).clip(1).frame == 1
    sampler = Sampler([clip_set], None, 0)
    drawn = [sampler.draw(number) for number in range(5)]
    assert {each.clip.frame for each in drawn} <= {0, 3, 4}
    assert sum(bool(each.skipped) for each in drawn) == 2  # in an epoch of five clips
    everywhere = write_export(tmp_path / "none", 4, without=[(f, "image.cam_back.jpg") for f in range(4)])
    with pytest.raises(
        DataError, match="expected clips that can be used, found 50 others in a row: clips without an image"
    ):
        Sampler([ClipSet.create(shard_readers(everywhere)[0], frames=1)], None, 0).draw(0)


def test_images_at_other_times_are_left_out(tmp_path: Path) -> None:
    """Samples at a rate have the nearest image. Here images are 30 ms off; half an interval is 25 ms at 20 Hz, and 50
    at 10."""
    pytest.importorskip("PIL")
    (reader,) = shard_readers(write_export(tmp_path, 4, options={"times": {"rate": {"hz": 10.0}}}))
    assert ClipSet.create(reader, frames=1).clip(0).frame == 0
    reader.hz = 20.0
    with pytest.raises(Skip, match=r"clips with images of other times, .* \(off by 30 ms\)"):
        ClipSet.create(reader, frames=1).clip(0)


def test_exports_that_cannot_be_trained_on(tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    cases: list[tuple[dict[str, Any], str]] = [
        ({"images": False}, "expected shards with images, found an export without --images"),
        ({"maps": ["color", "depth"]}, "expected shards with the map boxes, found color, depth"),
        ({"export_layout": "mcap"}, "expected an export in the layout webdataset, found mcap"),
    ]
    for number, (options, text) in enumerate(cases):
        folder = write_export(tmp_path / str(number), 2, options=options)
        with pytest.raises(DataError, match=text) as caught:
            opened(folder)
        assert str(folder) in str(caught.value)
    folder = write_export(tmp_path / "recipe", 2)
    assert opened(folder, recipe=OF_EXPORT).recipe["drawn"] == "60x100"
    other = {**OF_EXPORT, "splat": "15:1,100:0"}
    with pytest.raises(DataError, match="expected maps with splat 15:1,100:0, found 15:2,35:1,100:0"):
        opened(folder, recipe=other)
    with pytest.raises(DataError, match="expected maps with drawn 256x448, found 60x100"):
        opened(folder, recipe={**OF_EXPORT, "drawn": "256x448", "size": "64x112"})
    with pytest.raises(DataError, match="expected maps with size 30x50, found 6x10"):
        opened(folder, recipe={**OF_EXPORT, "size": "30x50"})
    with pytest.raises(ConfigError, match="a pas-cache has maps alone"):
        opened(write_export(tmp_path / "cache", 2, options={"export_layout": "pas-cache"}))
    said: list[str] = []
    own = write_export(tmp_path / "own", 2, options={"size": None})
    assert opened(own, recipe={**OF_EXPORT, "drawn": "600x1000"}, say=said.append).recipe["drawn"] == "600x1000"
    assert len(said) == 1 and "not compared" in said[0]
    (folder / "2021.05.log-000000.tar").write_bytes(b"x" * 2000)
    with pytest.raises(DataError, match="expected a tar file"):
        opened(folder)
    (folder / "2021.05.log-000000.tar").unlink()
    with pytest.raises(DataError, match="the shard cannot be read: No such file"):
        opened(folder)
    with pytest.raises(DataError, match="expected complete shards, found none"):
        (tmp_path / "empty").mkdir()
        (tmp_path / "empty" / "export.json").write_text((folder / "export.json").read_text())
        opened(tmp_path / "empty")


def test_recordings_of_another_recipe_are_refused(tmp_path: Path) -> None:
    write_recording(tmp_path / "a.safetensors")
    write_recording(tmp_path / "b.safetensors", recipe={**RECIPE, "bins": {**RECIPE["bins"], "far_m": 50.0}})
    with pytest.raises(DataError, match='expected maps with bins .*"far_m": 100.0.* found .*50.0.*b.safetensors'):
        opened(tmp_path)
    same = {**RECIPE, "splat": "15.0:1,100:0", "radius_m": 100}
    assert len(opened(tmp_path / "a.safetensors", recipe=same).train) == 1


def test_weights_say_how_often_clips_are_drawn(tmp_path: Path) -> None:
    for name, frames in (("a", 5), ("b", 9), ("c", 3)):
        write_recording(tmp_path / f"{name}.safetensors", frames, log=name)
    (tmp_path / "two").mkdir()
    for name in ("b", "c"):
        (tmp_path / f"{name}.safetensors").rename(tmp_path / "two" / f"{name}.safetensors")
    specs = [tmp_path / "a.safetensors", tmp_path / "two"]

    def shares(weights: Any) -> Any:
        return opened(*specs, frames=2, weights=weights).shares

    assert shares(None) is None
    np.testing.assert_allclose(shares((3.0, 1.0)), [3, 0.8, 0.2])  # 8 and 2 clips
    np.testing.assert_allclose(shares({"a": 2.0, "[bc]": 0.5}), [2, 0.5, 0.5])
    np.testing.assert_allclose(shares({"c": 0.0}), [1, 1, 0])
    for weights, text in (((1.0,), "data.weights of 2 numbers"), ({"d": 1.0}, "found 'd', which no log matches")):
        with pytest.raises(ConfigError, match=text):
            shares(weights)
    data = opened(*specs, frames=2, weights=(3.0, 1.0))
    sampler = Sampler(data.train, data.shares, seed=3)
    count = 4000
    drawn = Counter(sampler.choose(number)[0] for number in range(count))
    for clip_set, share in enumerate((0.75, 0.2, 0.05)):
        spread = math.sqrt(count * share * (1 - share))
        assert abs(drawn[clip_set] - count * share) < 5 * spread
    clips = Counter(sampler.choose(number) for number in range(count))
    assert len(clips) == 4 + 8 + 2
    assert [sampler.choose(n) for n in range(20)] == [Sampler(data.train, data.shares, 3).choose(n) for n in range(20)]
    assert [sampler.choose(n) for n in range(20)] != [Sampler(data.train, data.shares, 4).choose(n) for n in range(20)]


def test_an_epoch_has_each_clip_once(tmp_path: Path) -> None:
    write_recording(tmp_path / "a.safetensors", 6, log="a")
    write_recording(tmp_path / "b.safetensors", 4, log="b")
    data = opened(tmp_path, frames=2)
    sampler = Sampler(data.train, data.shares, seed=1)
    assert len(sampler) == 8
    epochs = [[sampler.choose(8 * epoch + place) for place in range(8)] for epoch in range(3)]
    every = [(0, i) for i in range(5)] + [(1, i) for i in range(3)]
    assert all(sorted(epoch) == every for epoch in epochs)
    assert epochs[0] != epochs[1] != epochs[2]
    clips: list[Clip] = [sampler.statistic(number).clip for number in range(40)]
    assert {(clip.log, clip.frame) for clip in clips} == {("ab"[clip_set], index) for clip_set, index in every}


def test_logs_are_held_out(tmp_path: Path) -> None:
    for name in ("town-1", "town-2", "scene"):
        write_recording(tmp_path / f"{name}.safetensors", 6, log=name)
    data = opened(tmp_path, frames=2, hold_out_logs=("town-*",))
    assert [clip_set.reader.log for clip_set in data.train] == ["scene"]
    assert [clip_set.reader.log for clip_set in data.validation] == ["town-1", "town-2"]
    assert len(data.validation[0]) == 5
    with pytest.raises(DataError, match="expected clips|expected a log"):
        opened(tmp_path, frames=2, hold_out_logs=("*",))
    said: list[str] = []
    write_recording(tmp_path / "short.safetensors", 2, log="short")
    assert len(opened(tmp_path, frames=4, say=said.append).train) == 4
    assert len(said) == 1 and "short.safetensors: left out, 2 frames are too few for clips of 4" in said[0]
    with pytest.raises(
        DataError, match=r"expected a log of at least 9 frames without a gap, found logs of \[6, 2, 6, 6\]"
    ):
        opened(tmp_path, frames=3, every=4)
    with pytest.raises(DataError, match="expected the camera CAM_LEFT, found CAM_FRONT, CAM_BACK: .*scene.safetensors"):
        opened(tmp_path / "scene.safetensors", cameras=("CAM_LEFT",))


def test_rates_divide_those_of_logs(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    write_recording(path, 9, hz=12.0)
    clip = opened(path, frames=3, hz=6.0).train[0].clip(1)
    assert clip.frame == 1 and clip.hz == pytest.approx(6.0, rel=1e-5)
    assert np.diff(clip.t_us.numpy()).tolist() == pytest.approx([166_667] * 2, abs=1)
    with pytest.raises(DataError, match="expected data.hz that divides the rate of the frames, 12 Hz, found 5.0"):
        opened(path, frames=3, hz=5.0)


def test_clips_across_gaps_are_left_out_at_a_rate(tmp_path: Path) -> None:
    reader = RecordedReader(tmp_path / write_gap(tmp_path))
    assert reader.hz == 5.0
    clip_set = ClipSet.create(reader, frames=2, hz=5.0)
    assert clip_set.runs == ((0, 1, 2), (3, 4)) and len(clip_set) == 3
    assert len(ClipSet.create(reader, frames=2)) == 4  # not at a rate


def write_gap(folder: Path) -> str:
    """A recording whose fourth frame comes 0.6 s after the third."""
    t_us = np.array([0, 200_000, 400_000, 1_000_000, 1_200_000])
    poses, sizes = np.tile(np.eye(4), (5, 1, 1)), np.array([[8, 12]] * 2)
    write_recording(
        folder / "gap.safetensors", 5, changed={"t_us": t_us, "global_from_ego": poses, "original_sizes": sizes}
    )
    return "gap.safetensors"


def test_motions_and_cameras_are_those_of_the_protocol() -> None:
    """The ego moves two meters along x at a yaw of 0.4, and turns 0.1 to the left; as in the program's own test."""
    before, after = moved_by(np.eye(4), [-1, 0, 0.4]), moved_by(np.eye(4), [1, 0, 0.5])
    np.testing.assert_allclose(ego_motion(before, after), [2 * math.cos(0.4), -2 * math.sin(0.4), 0.1], atol=1e-6)
    assert ego_motion(None, after).tolist() == [0, 0, 0]
    mounted = np.eye(4)
    mounted[:3, 3] = 1, 2, 3
    numbers = camera_numbers(mounted[None], np.array([[[3.0, 0, 3], [0, 3, 2], [0, 0, 1]]]), np.array([[4, 6]]))
    assert numbers.tolist() == [[1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 3, 0.5, 0.75, 0.5, 0.5]]
    np.testing.assert_allclose(joined([1, 0, math.pi / 2], [1, 0, math.pi / 2]), [1, 1, math.pi], atol=1e-6)


def test_depth_bins_are_those_of_the_renderer() -> None:
    """Ends of the range, as in the program's own test; other depths by the formula in docs/src/reference/maps.md."""
    linear = {"scale": "linear", "count": 256, "far_m": 50.0, "gamma": 1.0}
    log = {**linear, "scale": "log"}
    empty = np.array([np.inf, np.nan, -300.0, 0.0], np.float32)
    for bins in (linear, log):
        assert depth_bins(empty, bins).tolist() == [0] * 4
        ends = depth_bins(np.array([1e-5, 50.0, 1e9], np.float32), bins)
        assert ends[0] == 1 and ends[1] == ends[2]
    assert depth_bins(np.array([50.0], np.float32), linear).tolist() == [256]
    depths = np.array([0.1, 9.7, 9.9, 25.0, 49.9], np.float32)
    assert depth_bins(depths, linear).tolist() == [1 + math.floor(d / 50 * 255) for d in (0.1, 9.7, 9.9, 25.0, 49.9)]
    near = round(0.85 * 256)
    expected = [1 + math.floor(math.log1p(d) / math.log1p(30) * (near - 1)) for d in (0.1, 9.7, 9.9, 25.0)]
    expected.append(1 + near + math.floor(math.log1p(49.9 - 30) / math.log1p(20) * (256 - near - 1)))
    assert depth_bins(depths, log).tolist() == expected


def test_recipes_are_complete_and_checked() -> None:
    recipe = complete({"drawn": "256x448", "bins": {"far_m": 50.0}})
    assert recipe["size"] == "64x112" and recipe["bins"] == {
        "scale": "linear",
        "count": 256,
        "far_m": 50.0,
        "gamma": 1.0,
    }
    keywords = renderer_keywords(recipe)
    assert (keywords["size"], keywords["out_size"], keywords["far"]) == ((256, 448), (64, 112), 50.0)
    for wrong, text in (
        ({"colour_filter": "x"}, "found 'colour_filter'"),
        ({"bins": {"n": 3}}, "found 'n'"),
        ({"size": "64"}, "expected recipe.size of HEIGHTxWIDTH"),
        ({"drawn": "32x56"}, "expected recipe.drawn of 64x112 or larger, found 32x56"),
        ({"bins": {"count": 1}}, "recipe.bins.count of 2"),
        ({"bins": {"scale": "cubic"}}, "recipe.bins.scale"),
        ({"radius_m": 0}, "recipe.radius_m above 0"),
        ({"splat": "15"}, "recipe.splat of Z:R"),
    ):
        with pytest.raises(ConfigError, match=text):
            complete(wrong)
