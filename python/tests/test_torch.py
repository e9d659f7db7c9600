"""Datasets for PyTorch."""

import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from conftest import TOWN, Run

torch = pytest.importorskip("torch")
from pskel.torch import ConditionDataset, ConditionStream  # noqa: E402
from torch.utils.data import DataLoader  # noqa: E402

OUT = (28, 50)


@pytest.fixture(scope="module")
def sources(skeleton: pskel.Skeleton) -> list[tuple[str, str]]:
    return [(TOWN, str(skeleton.path))]


def moved(scene: pskel.Scene, rng: np.random.Generator) -> pskel.Scene:
    return scene.move_ego(left_m=float(rng.uniform(-1, 1)))


def batches(dataset: Any, workers: int, **options: Any) -> list[dict[str, Any]]:
    loader: Any = DataLoader(dataset, batch_size=1, num_workers=workers, **options)
    return [{name: value.clone() for name, value in batch.items()} for batch in loader]


def test_items_have_the_documented_shapes(sources: list[tuple[str, str]], log: pskel.Log) -> None:
    dataset = ConditionDataset(sources, out_size=OUT, frames=2)
    assert len(dataset) == 3
    item = dataset[1]
    shapes = {name: (tuple(value.shape), value.dtype) for name, value in item.items()}
    assert shapes == {
        "points": ((2, 6, 20, *OUT), torch.float32),
        "layout": ((2, 6, 6, *OUT), torch.float32),
        "images": ((2, 6, 3, *OUT), torch.uint8),
        "intrinsics": ((2, 6, 3, 3), torch.float64),
        "camera_from_global": ((2, 6, 4, 4), torch.float64),
        "global_from_ego": ((2, 4, 4), torch.float64),
        "t_us": ((2,), torch.int64),
    }
    assert item["t_us"].tolist() == log.times_us[1:3]
    assert item["intrinsics"][0, 0, 0, 2] == pytest.approx(log[1].intrinsics[0, 0, 2] / 4)
    assert all(torch.equal(dataset[-2][name], value) for name, value in item.items())
    for index in (3, -4):
        with pytest.raises(IndexError):
            dataset[index]


@pytest.mark.parametrize("start", ["fork", "forkserver", "spawn"])
def test_workers_give_the_bytes_of_one(sources: list[tuple[str, str]], start: str, tmp_path: Path) -> None:
    program = f"""
import torch
from torch.utils.data import DataLoader
from test_torch import OUT, batches, moved
from pskel.torch import ConditionDataset
if __name__ == "__main__":
    dataset = ConditionDataset({sources!r}, out_size=OUT, augment=moved, seed=5)
    two = batches(dataset, 2, multiprocessing_context={start!r})
    one = batches(dataset, 0)
    again = batches(dataset, 0)
    assert len(one) == len(two) == 4
    for first, second, third in zip(one, two, again):
        for name in first:
            assert torch.equal(first[name], second[name]), name
            assert torch.equal(first[name], third[name]), name
    dataset.set_epoch(1)
    other = batches(dataset, 0)
    assert not torch.equal(other[0]["points"], one[0]["points"])
    print("equal")
"""
    script = tmp_path / "workers.py"
    script.write_text(program)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    command = [sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment, check=False)
    assert done.stdout == "equal\n", done.stdout + done.stderr


def test_streams_share_the_clips_among_workers(sources: list[tuple[str, str]]) -> None:
    stream = ConditionStream(sources, out_size=OUT, images=False)
    whole = [batch["t_us"].item() for batch in batches(stream, 0)]
    shared = [batch["t_us"].item() for batch in batches(stream, 2, multiprocessing_context="spawn")]
    assert len(whole) == 4 and sorted(shared) == whole


def test_a_killed_worker_leaves_no_process(sources: list[tuple[str, str]]) -> None:
    dataset = ConditionDataset(sources, out_size=OUT)
    loader: Any = DataLoader(dataset, batch_size=1, num_workers=1, multiprocessing_context="spawn", prefetch_factor=1)
    batches = iter(loader)
    next(batches)
    worker = batches._workers[0]
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(RuntimeError, match="DataLoader worker"):
        for _ in batches:
            pass
    worker.join(10)
    assert worker.exitcode == -signal.SIGKILL
    del batches


def test_arrays_become_tensors_without_a_copy(log: pskel.Log, renderer: pskel.Renderer) -> None:
    depth = renderer.render(log[0])["depth"]
    tensor = torch.from_numpy(depth)
    assert tensor.data_ptr() == depth.ctypes.data
    assert torch.from_dlpack(depth).data_ptr() == depth.ctypes.data


def test_clips_take_every_nth_frame_or_a_rate(sources: list[tuple[str, str]], log: pskel.Log) -> None:
    times = log.times_us
    assert len(times) == 4
    rate = 1e6 / (times[1] - times[0])
    options: dict[str, Any] = {"out_size": OUT, "frames": 2, "images": False}
    for dataset in (ConditionDataset(sources, every=2, **options), ConditionDataset(sources, hz=rate / 2, **options)):
        assert [item["t_us"].tolist() for item in dataset] == [[times[0], times[2]], [times[1], times[3]]]
    consecutive = ConditionDataset(sources, hz=rate, **options)
    assert [item["t_us"].tolist() for item in consecutive] == [times[i : i + 2] for i in range(3)]
    moved = ConditionDataset(sources, every=3, augment=lambda scene, _: scene.move_ego(left_m=1.0), **options)
    assert len(moved) == 1 and moved[0]["t_us"].tolist() == [times[0], times[3]]
    stream = ConditionStream(sources, every=2, **options)
    assert [item["t_us"].tolist() for item in stream] == [[times[0], times[2]], [times[1], times[3]]]


def test_clips_across_gaps_are_left_out_at_a_rate() -> None:
    from pskel.torch import _every
    from pskel.train.data.reader import is_steady

    times = np.array([0, 100_000, 201_000, 300_000, 900_000])
    assert [_every(times, hz, "log") for hz in (10, 5, 2)] == [1, 2, 5]
    assert is_steady(times[:4], 10) and is_steady(times[0:4:2], 5)
    assert not is_steady(times, 10) and not is_steady(times[0:5:2], 5)


def test_clips_at_half_the_rate_of_a_log(tmp_path: Path) -> None:
    text, folder = "town:seed=7,frames=6,hz=12,lidar_hz=20,size=57x100", tmp_path / "skeleton"
    times = pskel.Log(text).times_us
    assert np.diff(times).tolist() == pytest.approx([1e6 / 12] * 5, abs=1)
    pskel.build(pskel.Log(text), folder)
    dataset = ConditionDataset(
        [(text, str(folder))], out_size=OUT, frames=2, stride=2, hz=6.0, numbers=True, images=False, rasterizer="cpu"
    )
    assert [item["t_us"].tolist() for item in dataset] == [[times[0], times[2]], [times[2], times[4]]]
    # The motion since the frame before the clip, at the same spacing.
    torch.testing.assert_close(dataset[1]["action"][0], dataset[0]["action"][1], rtol=0, atol=0)
    with pytest.raises(ValueError, match="expected hz that divides the rate of the key frames, 12 Hz, found 5.0"):
        ConditionDataset([(text, str(folder))], out_size=OUT, hz=5.0)


def test_captions_of_files(sources: list[tuple[str, str]], log: pskel.Log, tmp_path: Path) -> None:
    path = tmp_path / "captions.json"
    path.write_text(json.dumps({log.name: {"weather": "rain"}}))
    options: dict[str, Any] = {"out_size": OUT, "frames": 2, "images": False, "rasterizer": "cpu"}
    dataset = ConditionDataset(sources, captions=path, **options)
    assert dataset[1]["captions"] == [["rain. This is a nuplan video clip from town"] * 6] * 2
    pickled = pickle.loads(pickle.dumps(dataset))
    assert pickled[1]["captions"] == dataset[1]["captions"]
    path.write_text(json.dumps({"other": "Sun"}))
    assert ConditionDataset(sources, captions=str(path), **options)[0]["captions"] == [[""] * 6] * 2
    path.write_text("[]")
    with pytest.raises(pskel.Error, match="expected .*, found an array .*captions.json"):
        ConditionDataset(sources, captions=path, **options)


def test_bad_rates_are_rejected(sources: list[tuple[str, str]], log: pskel.Log) -> None:
    make: Callable[..., Any] = ConditionDataset
    rate = 1e6 / (log.times_us[1] - log.times_us[0])
    for options, said in (
        ({"every": 2, "hz": rate}, "expected every or hz, found both"),
        ({"every": 0}, "expected every of 1 or more, found 0"),
        ({"hz": 0.0}, "expected hz above 0, found 0.0"),
        ({"hz": float("nan")}, "expected hz above 0, found nan"),
        ({"hz": rate * 2}, "expected hz that divides the rate of the key frames"),
        ({"hz": rate / 1.5}, "expected hz that divides the rate of the key frames"),
        ({"every": 2, "frames": 3}, r"at least 5 key frames, found logs of \[4\]"),
    ):
        with pytest.raises(ValueError, match=said):
            make(sources, out_size=OUT, **options)


def test_bad_options_are_rejected(sources: list[tuple[str, str]]) -> None:
    make: Callable[..., Any] = ConditionDataset
    with pytest.raises(ValueError, match="frames, stride and open_logs of 1 or more"):
        make(sources, out_size=OUT, frames=0)
    for option in ("maps", "log", "colour"):
        with pytest.raises(TypeError, match=f"expected the options .*splat.*, found {option}"):
            make(sources, out_size=OUT, **{option: ["color"]})
    with pytest.raises(ValueError, match=r"at least 9 key frames, found logs of \[4\]"):
        make(sources, out_size=OUT, frames=9)
    with pytest.raises(ValueError, match="expected a skeleton of log town-8-2f.*, found one of town-7-4f"):
        make([("town:seed=8,frames=2,size=113x200", sources[0][1])], out_size=OUT)


def test_a_skeleton_of_several_logs_is_of_each_source(tmp_path: Path, run: Run) -> None:
    texts = ["town:seed=8,frames=2,size=113x200", "town:seed=7,frames=2,size=113x200"]
    both = str(tmp_path / "both")
    run("-m", "pskel", "build", texts[1], texts[0], "--out", both)
    dataset = ConditionDataset([(text, both) for text in texts], out_size=OUT, frames=2, images=False)
    for text, item in zip(texts, dataset, strict=True):
        log = pskel.Log(text)
        renderer = pskel.Renderer(pskel.Skeleton(both), out_size=OUT, maps=["tensor"], log=log.name)
        assert item["t_us"].tolist() == log.times_us
        np.testing.assert_array_equal(item["points"][1], renderer.render(log[1])["points"])


def test_a_worker_forked_after_rendering_says_so(sources: list[tuple[str, str]], run: Run) -> None:
    program = f"""
from pskel.torch import ConditionDataset
from torch.utils.data import DataLoader
dataset = ConditionDataset({sources!r}, out_size={OUT})
dataset[0]
list(DataLoader(dataset, num_workers=1, multiprocessing_context="fork"))
"""
    done = run("-c", program, check=False)
    assert done.returncode == 1 and "RenderError" in done.stderr, done.stderr
    assert 'multiprocessing_context="forkserver"' in done.stderr, done.stderr
