"""Exports on a Ray cluster of one machine."""

import json
import logging
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pskel
import pytest

ray = pytest.importorskip("ray")
import pskel.ray  # noqa: E402

TOWNS = [f"town:seed={seed},frames=3,size=57x100" for seed in range(301, 304)]
OPTIONS: dict[str, Any] = {"layout": "webdataset", "shard_frames": 1, "rasterizer": "cpu"}


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    ray.init(num_cpus=2, include_dashboard=False, logging_level=logging.ERROR, log_to_driver=False)
    yield
    ray.shutdown()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export without a cluster, with its skeletons beside it."""
    folder = tmp_path_factory.mktemp("whole")
    report = pskel.export(TOWNS, folder / "out", skeletons=folder / "skeletons", **OPTIONS)
    assert report["complete"]
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def worker_pids() -> list[int]:
    """Ray workers that run a task of the export."""
    listed = subprocess.run(["ps", "-eo", "pid,args"], capture_output=True, text=True, check=True).stdout
    lines = [line.split(None, 1) for line in listed.splitlines()[1:]]
    return [int(pid) for pid, args in lines if args.startswith("ray::_export_log")]


def test_killed_workers_cost_nothing(tmp_path: Path, whole: Path) -> None:
    kills: list[list[int]] = []
    done = threading.Event()

    def kill() -> None:
        generator = random.Random(7)
        while not done.is_set() and len(kills) < 4:
            time.sleep(generator.uniform(0.3, 1.5))
            pids = worker_pids()
            if pids:
                os.kill(generator.choice(pids), signal.SIGKILL)
                kills.append(pids)

    killer = threading.Thread(target=kill)
    killer.start()
    damaged = "nuscenes:/nowhere"
    report = pskel.ray.export([*TOWNS, damaged], tmp_path / "out", workers=2, retries=20, **OPTIONS)
    done.set()
    killer.join()
    assert kills, "no worker was found to kill"
    assert [failure["name"] for failure in report["failures"]] == [damaged]
    assert files(tmp_path / "out") == files(whole / "out")


def test_shards_may_be_remote(tmp_path: Path, whole: Path) -> None:
    pytest.importorskip("fsspec")
    url = f"file://{tmp_path}/store"
    report = pskel.ray.export(TOWNS, url, workers=2, **OPTIONS)
    assert report["complete"] and report["written"] == 9
    assert files(tmp_path / "store") == files(whole / "out")
    (tmp_path / "store" / "shards").joinpath(sorted(os.listdir(tmp_path / "store" / "shards"))[0]).unlink()
    report = pskel.ray.export(TOWNS, url, workers=2, **OPTIONS)
    assert (report["written"], report["present"]) == (1, 8)


def test_logs_may_be_remote(tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    subprocess.run(
        [sys.executable, "-m", "pskel", "town", "seed=5,frames=3,size=57x100", "--out", tmp_path / "town"],
        check=True,
        capture_output=True,
    )
    local = pskel.export(f"nuscenes:{tmp_path}/town", tmp_path / "out", skeletons=tmp_path / "sk", **OPTIONS)
    assert local["complete"], local
    remote = pskel.ray.export(f"nuscenes:file://{tmp_path}/town", tmp_path / "out2", skeletons=tmp_path / "sk2", **OPTIONS)
    assert remote["complete"], remote
    assert files(tmp_path / "out") == files(tmp_path / "out2")


def test_the_command_prints_a_report(tmp_path: Path, whole: Path) -> None:
    args = ["export", TOWNS[0], "--out", str(tmp_path / "out"), "--workers", "1", "--layout", "webdataset"]
    args += ["--shard-frames", "1", "--rasterizer", "cpu", "--skeletons", str(whole / "skeletons")]
    done = subprocess.run([sys.executable, "-m", "pskel.ray", *args], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout[done.stdout.index("{") :])
    assert (report["written"], report["complete"]) == (3, True)
    with pytest.raises(SystemExit, match="2"):
        pskel.ray.main(["export"])


def test_no_gpu_is_no_device() -> None:
    assert ray.get(ray.remote(pskel.ray.device).remote()) is None
