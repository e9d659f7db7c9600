"""What goes wrong ends with one clear line, and loses nothing that was saved."""

import errno
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("accelerate")
pytest.importorskip("safetensors")
from pskel.train import Config, ConfigError  # noqa: E402
from train_base import RECIPE, assert_equal_weights, losses, run, run_two, start  # noqa: E402
from train_base import write_config, write_recording  # noqa: E402

PORT = 29910 + os.getpid() % 300


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    write_recording(tmp_path / "a.safetensors", 12, log="scene", seed=1)
    return tmp_path / "a.safetensors"


def config(tmp_path: Path, **tables: Any) -> Path:
    return write_config(tmp_path / "config.toml", **tables)


def failure(*arguments: object) -> str:
    """Run the command, which has to fail; returns its last line, the only one of the error."""
    done = run(*arguments, check=False)
    assert done.returncode == 1, done
    lines = [line for line in done.stderr.splitlines() if line.startswith("pskel.train: ")]
    assert len(lines) == 1 and done.stderr.splitlines()[-1] == lines[0] and "Traceback" not in done.stderr, done.stderr
    return lines[0]


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("train.stepz=5", "expected the keys steps, .* in \\[train\\], found 'stepz'"),
        ("data.frame=5", "in \\[data\\], found 'frame'"),
        ("trane.steps=5", "expected the keys network, train, data, options, found 'trane'"),
        ("train.steps=many", 'expected a whole number for train.steps, found "many"'),
        ("train.steps=1.5", "expected a whole number for train.steps, found 1.5"),
        ("train.steps=0", "expected train.steps of 1 or more, found 0"),
        ("train.learning_rate=true", "expected a number for train.learning_rate, found true"),
        ("train.betas=[0.9]", "expected two numbers for train.betas"),
        ("train.betas=[0.9, 1]", "expected train.betas of 0 to below 1, found 1.0"),
        ("train.ema=1", "expected train.ema of 0 to below 1, found 1.0"),
        ("train.schedule=linear", "expected train.schedule of constant, cosine, found 'linear'"),
        ("train.precision=f16", "expected train.precision of f32, bf16"),
        ("train.shard=ddp", "expected train.shard of none, fsdp"),
        ("train.optimizer=sgd", "expected train.optimizer of adamw, adamw8bit"),
        ("data.hold_out=1", "expected data.hold_out of 0, or of 2 or more, found 1"),
        ("data.hz=0", "expected data.hz above 0, found 0.0"),
        ("data.cameras=front", 'expected a list for data.cameras, found "front"'),
        ("data.cameras=[1]", "expected a text for data.cameras, found 1"),
        ("data.weights=[-1.0]", "expected data.weights of 0 or more, found -1.0"),
        ("data.recipe=x", 'expected a table for data.recipe, found "x"'),
        ("network=large", 'expected network of small, pas, pas-image or MODULE:FUNCTION, found "large"'),
        ("train", "expected --set KEY=VALUE"),
    ],
)
def test_configurations_are_checked(tmp_path: Path, setting: str, said: str) -> None:
    file = config(tmp_path)
    with pytest.raises(ConfigError, match=said) as caught:
        Config.read(file, [setting])
    assert str(caught.value).endswith(str(file)) and "\n" not in str(caught.value)


def test_configurations_are_read(tmp_path: Path) -> None:
    file = config(
        tmp_path,
        train={"learning_rate": 1, "betas": [0.5, 0.9]},
        data={"weights": {"a*": 2}, "recipe": {"size": "8x12"}},
    )
    settings = [
        "train.steps=7",
        "options.width=0.5",
        "data.cameras=['A', 'B']",
        "data.captions=x.json",
        "options.critic=true",
    ]
    found = Config.read(file, settings)
    assert (found.train.steps, found.train.learning_rate, found.train.betas) == (7, 1.0, (0.5, 0.9))
    assert (found.data.weights, found.data.cameras, found.data.captions) == ({"a*": 2.0}, ("A", "B"), "x.json")
    assert found.options == {"width": 0.5, "critic": True} and found.data.recipe == {"size": "8x12"}
    same = tmp_path / "config.json"
    same.write_text(json.dumps({"network": "small", "train": {"steps": 7}, "small": {"width": 3}}))
    assert Config.read(same).options == {"width": 3} and Config.read(same).train.steps == 7
    assert json.loads(json.dumps(found.to_json())) == found.to_json()
    for content, text in (
        ("[train", "expected TOML"),
        ("network = 5", "found 5"),
        ("network = 'a:b'\ntrain = 5", r"a table \[train\]"),
    ):
        file.write_text(content)
        with pytest.raises(ConfigError, match=text):
            Config.read(file)
    with pytest.raises(ConfigError, match="cannot be read: No such file or directory: .*none.toml"):
        Config.read(tmp_path / "none.toml")


def test_the_command_says_what_is_wrong(tmp_path: Path, clip: Path) -> None:
    file, out = config(tmp_path), tmp_path / "out"
    assert "found 'wide'" not in failure(file, "--data", clip, "--out", out, "--set", "options.noize=1")
    assert "expected options of the tiny network, found noize" in failure(
        file, "--data", clip, "--out", out, "--set", "options.noize=1"
    )
    assert "network 'nowhere:task' cannot be loaded" in failure(
        file, "--data", clip, "--out", out, "--set", "network=nowhere:task"
    )
    assert "has no function 'tusk'" in failure(file, "--data", clip, "--out", out, "--set", "network=train_base:tusk")
    missing = tmp_path / "none.safetensors"
    assert f"cannot be read: No such file or directory: {missing}" in failure(file, "--data", missing, "--out", out)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert str(empty) in failure(file, "--data", empty, "--out", out)
    assert not (out / "loss.csv").exists()  # nothing was begun


def test_clips_without_images_or_of_another_recipe(tmp_path: Path, clip: Path) -> None:
    other, bare = tmp_path / "other.safetensors", tmp_path / "bare.safetensors"
    write_recording(other, recipe={**RECIPE, "color_filter": "visible-area"})
    write_recording(bare, without=["truth"])
    file, out = config(tmp_path), tmp_path / "out"
    text = failure(file, "--data", clip, other, "--out", out)
    assert f"expected maps with color_filter bilinear, found visible-area: {other}" in text
    text = failure(
        file, "--data", clip, "--out", out, "--set", "data.recipe.size=8x12", "--set", "data.recipe.drawn=16x24"
    )
    assert f"expected maps with color_filter visible-area, found bilinear: {clip}" in text
    assert f"expected a clip with images (the array truth), found none: {bare}" in failure(
        file, "--data", bare, "--out", out
    )


def test_output_folders_are_checked(tmp_path: Path, clip: Path) -> None:
    file, out = config(tmp_path), tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("")
    assert f"expected an empty folder or a training, found thesis.tex: {out}" in failure(
        file, "--data", clip, "--out", out
    )
    assert sorted(path.name for path in out.iterdir()) in (["thesis.tex"], [".lock", "thesis.tex"])
    (out / "thesis.tex").unlink()
    run(file, "--data", clip, "--out", out)
    before = (out / "loss.csv").read_bytes()
    assert "pass --resume to continue it" in failure(file, "--data", clip, "--out", out)
    program = "import fcntl, sys; file = open(sys.argv[1], 'r+b'); fcntl.lockf(file, fcntl.LOCK_EX); print(1); input()"
    other = subprocess.Popen(
        [sys.executable, "-c", program, out / ".lock"], stdin=-1, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None and other.stdout.readline() == "1\n"
    text = failure(file, "--data", clip, "--out", out, "--resume")
    assert f"the output folder is in use by process {os.getpid()}: {out}" in text  # which had it before
    other.communicate("\n", timeout=60)
    assert (out / "loss.csv").read_bytes() == before
    assert "cannot be written: Not a directory" in failure(file, "--data", clip, "--out", clip / "out")


def test_checkpoints_of_another_configuration_are_refused(tmp_path: Path, clip: Path) -> None:
    file, out = config(tmp_path, train={"validate": 0}), tmp_path / "out"
    run(file, "--data", clip, "--out", out)
    for setting, key in (
        ("train.learning_rate=0.5", "train.learning_rate is 0.02 there, 0.5 here"),
        ("train.seed=1", "train.seed is 0 there, 1 here"),
        ("train.batch=2", "train.batch is 1 there, 2 here"),
        ("train.accumulate=2", "batches_per_step is 1 there, 2 here"),
        ("options.noise=true", "options.noise is null there, true here"),
        ("data.frames=3", r'clips.0 is \["scene", 0, 11\] there, \["scene", 0, 10\] here'),
        ("data.hold_out=2", r'clips.0 is \["scene", 0, 11\] there, \["scene", 0, 5\] here'),
    ):
        text = failure(file, "--data", clip, "--out", out, "--resume", "--set", setting)
        assert "the checkpoint has another configuration: " in text and str(out / "checkpoint-6") in text
        assert re.search(key, text), text
    other = tmp_path / "b.safetensors"
    write_recording(other, 12, log="another")
    text = failure(file, "--data", clip, other, "--out", out, "--resume")
    assert 'clips.1 is null there, ["another", 0, 11] here' in text
    # Keys that do not change losses may differ, and more steps at a constant rate.
    free = ["--set", "train.workers=1", "--set", "train.checkpoint=3", "--steps", 9]
    run(file, "--data", clip, "--out", out, "--resume", *free)
    assert [row["step"] for row in losses(out)] == list(range(1, 10))
    cosine = tmp_path / "cosine"
    run(file, "--data", clip, "--out", cosine, "--set", "train.schedule=cosine")
    text = failure(file, "--data", clip, "--out", cosine, "--resume", "--set", "train.schedule=cosine", "--steps", 9)
    assert "train.steps is 6 there, 9 here" in text


def test_damaged_checkpoints_are_refused(tmp_path: Path, clip: Path) -> None:
    file, out = config(tmp_path, train={"validate": 0}), tmp_path / "out"
    run(file, "--data", clip, "--out", out)
    state = out / "checkpoint-6" / "rank-0.pt"
    content = state.read_bytes()
    state.write_bytes(content[: len(content) // 2])
    assert "the checkpoint cannot be read: " in failure(file, "--data", clip, "--out", out, "--resume")
    # Without the damaged one, the one before is taken.
    shutil.rmtree(out / "checkpoint-6")
    done = run(file, "--data", clip, "--out", out, "--resume")
    assert "resumed from checkpoint-4" in done.stderr
    (out / "checkpoint-6" / "checkpoint.json").write_text("{}")
    assert "expected a checkpoint, found 'step'" in failure(file, "--data", clip, "--out", out, "--resume")


def test_a_loss_that_is_not_finite_ends_the_training(tmp_path: Path, clip: Path) -> None:
    options = {"fail": "nan", "step": 3}
    file, out = config(tmp_path, options=options, train={"batch": 2}), tmp_path / "out"
    text = failure(file, "--data", clip, "--out", out)
    assert "the loss of network is not finite in step 4, clips scene:" in text and text.count("scene:") == 2, text
    assert "lower train.learning_rate" in text and text.endswith("checkpoint-2 remains")
    assert [row["step"] for row in losses(out)] == [1, 2, 3]
    state = torch.load(out / "checkpoint-2" / "rank-0.pt", weights_only=True)
    assert all(value.isfinite().all() for value in state["modules"]["network"].values())


def test_one_process_speaks_for_all(tmp_path: Path, clip: Path) -> None:
    file, out = config(tmp_path, options={"fail": "nan", "step": 1}), tmp_path / "out"
    first, second = run_two("-m", "pskel.train", file, "--data", clip, "--out", out, port=PORT + 2)
    assert first.returncode == second.returncode == 1
    assert first.stderr.splitlines()[-1].startswith("pskel.train: the loss of network is not finite in step 2, clips")
    assert second.stderr == ""


def test_a_gradient_that_is_not_finite_ends_the_training(tmp_path: Path, clip: Path) -> None:
    file, out = config(tmp_path, options={"fail": "gradient", "step": 1}), tmp_path / "out"
    assert "the gradient of network is not finite in step 2, clips scene:" in failure(
        file, "--data", clip, "--out", out
    )


def test_a_lack_of_memory_says_what_to_change(tmp_path: Path, clip: Path) -> None:
    file, out = config(tmp_path, options={"fail": "memory"}, train={"batch": 4}), tmp_path / "out"
    text = failure(file, "--data", clip, "--out", out)
    assert (
        "is not enough in step 1: use train.batch below 4 (and train.accumulate above 1), data.frames below 2" in text
    )
    assert 'train.precision = "bf16"' in text and "CUDA out of memory" in text


def test_a_killed_worker_ends_the_training(tmp_path: Path, clip: Path) -> None:
    file, out = config(tmp_path, options={"fail": "draw", "step": 2}, train={"workers": 1}), tmp_path / "out"
    assert "a process that reads clips was killed, out of memory? reduce train.workers" in failure(
        file, "--data", clip, "--out", out
    )


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let files have at most a size, as on a disk that is full."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_leaves_the_last_checkpoint(tmp_path: Path, clip: Path) -> None:
    file, out, whole = config(tmp_path, train={"validate": 0}), tmp_path / "out", tmp_path / "whole"
    run(file, "--data", clip, "--out", whole)
    run(file, "--data", clip, "--out", out, "--steps", 2)
    size = (out / "checkpoint-2" / "rank-0.pt").stat().st_size
    kept = {path.name: path.read_bytes() for path in (out / "checkpoint-2").iterdir()}
    with largest_file(size // 2):
        text = failure(file, "--data", clip, "--out", out, "--resume")
    assert f"the checkpoint cannot be written: File too large: {out / 'checkpoint-4'}" in text
    assert text.endswith("--resume continues from checkpoint-2")
    assert {path.name: path.read_bytes() for path in (out / "checkpoint-2").iterdir()} == kept
    assert not [path for path in out.iterdir() if "partial" in path.name or path.name == "checkpoint-4"]
    run(file, "--data", clip, "--out", out, "--resume")
    assert (out / "loss.csv").read_bytes() == (whole / "loss.csv").read_bytes()


@pytest.mark.parametrize(
    ("function", "said"),
    [
        ("safetensors.torch.save_file", "the weights cannot be written: No space left on device: {out}/weights.safe"),
        ("pskel.train.outputs.open", "the table cannot be written: No space left on device: {out}/loss.csv"),
        ("os.replace", "the file cannot be written: No space left on device: {out}/"),
    ],
)
def test_other_files_on_a_full_disk(
    tmp_path: Path, clip: Path, monkeypatch: pytest.MonkeyPatch, function: str, said: str
) -> None:
    """The last checkpoint remains, and the training goes on from it when there is space again."""
    file, out, whole = config(tmp_path), tmp_path / "out", tmp_path / "whole"
    run(file, "--data", clip, "--out", whole)
    run(file, "--data", clip, "--out", out, "--steps", 2)

    def full(*arguments: Any, **options: Any) -> Any:
        if function.endswith("open") and "a" not in arguments[1:]:
            return open(*arguments, **options)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(function, full, raising=False)
        assert said.format(out=out) in failure(file, "--data", clip, "--out", out, "--resume")
    assert not list(out.glob(".*.partial")) and (out / "checkpoint-2" / "rank-0.pt").is_file()
    run(file, "--data", clip, "--out", out, "--resume")
    assert (out / "loss.csv").read_bytes() == (whole / "loss.csv").read_bytes()
    assert_equal_weights(out, whole)


@pytest.mark.parametrize("fail", ["kill", "error"])
def test_a_process_that_dies_ends_the_others(tmp_path: Path, clip: Path, fail: str) -> None:
    file, out = config(tmp_path, options={"fail": fail, "step": 3, "rank": 1}), tmp_path / "out"
    begin = time.monotonic()
    arguments = [file, "--data", clip, "--out", out]
    first, second = run_two("-m", "pskel.train", *arguments, port=PORT + (fail == "kill"))
    assert time.monotonic() - begin < 200
    assert second.returncode == (-signal.SIGKILL if fail == "kill" else 1)
    assert first.returncode == 1
    lines = [line for line in first.stderr.splitlines() if line.startswith("pskel.train: ")]
    assert len(lines) == 1 and "another process of the training ended" in lines[0], first.stderr
    assert "Traceback" not in first.stderr, first.stderr
    assert (out / "checkpoint-2" / "checkpoint.json").is_file()


@pytest.mark.parametrize(
    ("number", "status", "text"), [(15, 1, "ended by signal 15"), (2, 130, "interrupted; --resume")]
)
def test_a_stopped_process_says_so(tmp_path: Path, clip: Path, number: int, status: int, text: str) -> None:
    file, out = config(tmp_path, train={"steps": 1_000_000, "checkpoint": 1_000_000}), tmp_path / "out"
    process = start("-m", "pskel.train", file, "--data", clip, "--out", out)
    while not (out / "loss.csv").is_file() or (out / "loss.csv").read_bytes().count(b"\n") < 3:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(number)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == status and said.splitlines()[-1].startswith(f"pskel.train: {text}"), said


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_preparing_ends_with_the_training(number: int) -> None:
    program = (
        "import time; from pskel.train.data.jobs import in_rounds; from pskel.train.parallel import Processes; "
        "in_rounds(Processes(), [(time.sleep, (600,))], ['sleeping'], lambda text: None)"
    )
    process = start("-c", program)
    children: list[Path] = []
    while len(children) < 2:  # the child, and the resource tracker of multiprocessing
        assert process.poll() is None
        time.sleep(0.02)
        found = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        children = [Path("/proc", child, "cmdline") for child in found]
    process.send_signal(number)
    process.wait(timeout=60)
    deadline = time.monotonic() + 60
    while any(child.is_file() and child.read_bytes() for child in children):
        assert time.monotonic() < deadline
        time.sleep(0.02)
