"""Runs of the command: outputs, resuming after a kill, several processes, accumulation."""

import json
import os
import shlex
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("accelerate")
pytest.importorskip("safetensors")
from train_base import assert_equal_weights, losses, run, run_two, start, weights_of  # noqa: E402
from train_base import write_config, write_recording  # noqa: E402

PORT = 29610 + os.getpid() % 300


@pytest.fixture
def clips(tmp_path: Path) -> list[Path]:
    """Recorded clips of two logs."""
    paths = [tmp_path / "a.safetensors", tmp_path / "b.safetensors"]
    write_recording(paths[0], 12, log="first", seed=1)
    write_recording(paths[1], 8, log="second", seed=2)
    return paths


def config(tmp_path: Path, **tables: Any) -> Path:
    return write_config(tmp_path / "config.toml", **tables)


def test_a_run_writes_everything(tmp_path: Path, clips: list[Path]) -> None:
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("tensorboard")
    out = tmp_path / "out"
    file = config(tmp_path, train={"ema": 0.9}, data={"hold_out": 4}, options={"critic": True, "critic_start": 2})
    done = run(file, "--data", *clips, "--out", out)
    assert "no GPU found" in done.stderr and "step 6/6, loss" in done.stderr and "left" in done.stderr, done.stderr
    names = sorted(path.name for path in out.iterdir() if path.name != ".lock")
    assert names == [
        "checkpoint-4", "checkpoint-6", "loss.csv", "scores.csv", "tb", "training.json", "validation",
        "weights.safetensors",
    ]  # fmt: skip
    rows = losses(out)
    assert [row["step"] for row in rows] == [1, 2, 3, 4, 5, 6]
    assert ["critic.loss" in row for row in rows] == [False, False, True, True, True, True]
    assert rows[-1]["network.loss"] < 0.5 * rows[0]["network.loss"]
    assert {row["critic.learning_rate"] for row in rows[2:]} == {4e-4}
    # Held-out frames are 3, 7 and 11: two clips of the first log begin at 3 and 7, that of the second at 3.
    scores = (out / "scores.csv").read_text().splitlines()
    assert scores[0] == "step,square,frame" and [line.split(",")[0] for line in scores[1:]] == ["3", "6"]
    assert float(scores[1].split(",")[2]) == pytest.approx((3 + 7 + 3) / 3)
    with image.open(out / "validation" / "6.png") as picture:
        assert picture.size == (3 * 12, 4 * 8)  # three clips, two cameras generated and recorded
    found, header = weights_of(out)
    assert header == {"format": "tiny", "seed": "0", "steps": "6", "logs": '["first", "second"]'}
    state = torch.load(out / "checkpoint-6" / "rank-0.pt", weights_only=True)
    assert torch.equal(found["inner.weight"], state["ema"]["inner.weight"])
    assert torch.equal(found["mean"], state["modules"]["network"]["mean"]) and found["mean"].abs().sum() > 0
    assert not torch.equal(found["inner.weight"], state["modules"]["network"]["inner.weight"])


def test_weights_say_how_they_were_trained(tmp_path: Path, clips: list[Path]) -> None:
    """The header has the seed, the steps so far, the logs that are trained on, and a command that a shell reads."""
    from safetensors import safe_open

    out, file = tmp_path / "out of\" tune", config(tmp_path, train={"seed": 7, "validate": 0})
    arguments = [file, "--data", *clips, "--out", out, "--set", 'data.hold_out_logs=["sec*"]']
    for more, steps in (["--steps", "4"], 4), (["--resume"], 6):
        run(*arguments, *more)
        with safe_open(out / "weights.safetensors", "pt") as weights:
            training = json.loads(weights.metadata()["training"])
        command = training.pop("command")
        assert training == {"seed": 7, "steps": steps, "logs": ["first"]}
        given = [each for each in (*arguments, *more) if each != "--resume"]
        assert shlex.split(command) == ["python", "-m", "pskel.train", *map(str, given)]


def test_the_average_is_that_of_the_weights(tmp_path: Path, clips: list[Path]) -> None:
    """After each step n the average moves by 1 - min(decay, (1 + n) / (10 + n)) of the way to the weights."""
    weights = []
    for steps in range(1, 4):
        out = tmp_path / f"out-{steps}"
        run(config(tmp_path, train={"ema": 0.15, "validate": 0}), "--data", *clips, "--out", out, "--steps", steps)
        state = torch.load(out / f"checkpoint-{steps}" / "rank-0.pt", weights_only=True)
        weights.append((state["modules"]["network"]["inner.weight"].double(), state["ema"]["inner.weight"].double()))
    decays = [1 / 10, 0.15, 0.15]  # (1 + 1) / (10 + 1) is above 0.15
    for number in (1, 2):
        expected = decays[number] * weights[number - 1][1] + (1 - decays[number]) * weights[number][0]
        torch.testing.assert_close(weights[number][1], expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_killed_run_resumes_with_the_same_losses(tmp_path: Path, clips: list[Path], workers: int) -> None:
    train = {"ema": 0.99, "workers": workers, "schedule": "cosine", "warmup": 5, "clip_norm": 0.1}
    train |= {"steps": 60, "checkpoint": 5, "validate": 20}
    arguments = [config(tmp_path, train=train, options={"critic": True, "noise": True}), "--data", *clips]
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    run(*arguments, "--out", whole)
    command = ["-m", "pskel.train", *arguments, "--out", killed]
    process = start(*command)
    kills = 0
    while process.poll() is None:
        rows = (killed / "loss.csv").read_bytes().count(b"\n") if (killed / "loss.csv").is_file() else 0
        if rows >= 12 + 20 * kills and kills < 2:
            process.send_signal(signal.SIGKILL)
            assert process.wait() == -signal.SIGKILL
            kills += 1
            done = json.loads((sorted(killed.glob("checkpoint-*"))[-1] / "checkpoint.json").read_text())
            assert 5 <= done["step"] < 60
            process = start(*command, "--resume")
        time.sleep(0.005)
    said = process.stderr.read() if process.stderr else ""
    assert process.returncode == 0 and kills >= 1 and "resumed from checkpoint-" in said, said
    assert len(losses(whole)) == 60
    assert (killed / "loss.csv").read_bytes() == (whole / "loss.csv").read_bytes()
    assert (killed / "scores.csv").read_bytes() == (whole / "scores.csv").read_bytes()
    assert_equal_weights(killed, whole)
    assert [path.name for path in killed.glob(".*")] == [".lock"]


def test_what_was_left_out_is_done_on_resuming(tmp_path: Path, clips: list[Path]) -> None:
    """A process that is killed right after its last checkpoint has written neither weights nor scores."""
    out = tmp_path / "out"
    file = config(tmp_path)
    run(file, "--data", *clips, "--out", out)
    scores = (out / "scores.csv").read_text()
    copy = tmp_path / "copy"
    copy.mkdir()
    (out / "weights.safetensors").rename(copy / "weights.safetensors")
    (out / "scores.csv").write_text("".join(scores.splitlines(keepends=True)[:-1]))
    rows = (out / "loss.csv").read_bytes()
    done = run(file, "--data", *clips, "--out", out, "--resume")
    assert "resumed from checkpoint-6" in done.stderr and "validation after step 6" in done.stderr
    assert_equal_weights(out, copy)
    assert (out / "scores.csv").read_text() == scores
    assert (out / "loss.csv").read_bytes() == rows
    assert "validation after step" not in run(file, "--data", *clips, "--out", out, "--resume").stderr


def test_the_seed_changes_the_run(tmp_path: Path, clips: list[Path]) -> None:
    """Otherwise equal losses after a resume would mean nothing."""
    found: list[bytes] = []
    for seed in (0, 0, 1):
        out = tmp_path / f"out-{len(found)}"
        run(
            config(tmp_path), "--data", *clips, "--out", out, "--set", f"train.seed={seed}", "--set", "train.validate=0"
        )
        found.append((out / "loss.csv").read_bytes())
    assert found[0] == found[1] != found[2]


def difference(one: Path, other: Path) -> float:
    pairs = list(zip(losses(one), losses(other), strict=True))
    return max(abs(a[key] - b[key]) for a, b in pairs for key in a if key.endswith("loss"))


def assert_same(one: Path, other: Path) -> None:
    """The same losses, and the same weights in the end."""
    assert difference(one, other) < 1e-5
    found = weights_of(other)[0]
    for name, tensor in weights_of(one)[0].items():
        torch.testing.assert_close(found[name], tensor, rtol=0, atol=1e-5)


@pytest.fixture(scope="module")
def of_two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with trainings in two processes, one after the other in the same two."""
    folder = tmp_path_factory.mktemp("two")
    write_recording(folder / "a.safetensors", 12, log="first", seed=1)
    write_recording(folder / "b.safetensors", 8, log="second", seed=2)
    plain = write_config(folder / "plain.toml", options={"critic": True}, train={"ema": 0.9}, data={"hold_out": 4})
    noisy = write_config(
        folder / "noisy.toml", options={"noise": True}, train={"ema": 0.9, "clip_norm": 0.1, "accumulate": 2},
        data={"hold_out": 4},
    )  # fmt: skip
    critics = write_config(folder / "critics.toml", options={"critic": True, "critic_start": 2})
    fsdp = ["--set", "train.shard=fsdp"]
    again, wide = folder / "again", ["--set", "options.width=4096", "--set", "train.optimizer=adamw8bit"]
    runs = [
        [plain, "--out", folder / "plain"],
        [plain, "--out", folder / "added", "--set", "train.accumulate=2"],
        [noisy, "--out", folder / "whole"],
        [noisy, "--out", folder / "sharded", *fsdp],
        [noisy, "--out", again, *fsdp, "--steps", 4],
        [noisy, "--out", again, *fsdp, "--resume"],
        [noisy, "--out", folder / "eight", *fsdp, *wide],
        [noisy, "--out", folder / "eight-again", *fsdp, *wide, "--steps", 4],
        [noisy, "--out", folder / "eight-again", *fsdp, *wide, "--resume"],
        [plain, "--out", folder / "spare", "--set", "options.spare=true"],
        [critics, "--out", folder / "critics"],
        [critics, "--out", folder / "critics-sharded", *fsdp],
    ]
    data = ["--data", folder / "a.safetensors", folder / "b.safetensors"]
    texts = json.dumps([[str(part) for part in [*arguments, *data]] for arguments in runs])
    done = run_two(Path(__file__).with_name("train_base.py"), texts, port=PORT)
    assert [each.returncode for each in done] == [0, 0], done
    assert "step 6/6" in done[0].stderr
    # PyTorch warns where unused parameters are allowed and a player has none.
    lines = [line for line in done[1].stderr.splitlines() if "find_unused_parameters" not in line]
    assert lines == [], done[1].stderr
    return folder


def test_two_processes_equal_one(tmp_path: Path, of_two: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    arguments = [of_two / "plain.toml", "--data", of_two / "a.safetensors", of_two / "b.safetensors"]
    run(*arguments, "--out", one, "--set", "train.batch=2")
    assert_same(one, of_two / "plain")
    # One process without the clips of the second differs: the test can fail.
    run(*arguments, "--out", other)
    assert difference(one, other) > 1e-3
    expected, found = ((out / "scores.csv").read_text().splitlines()[1:] for out in (one, of_two / "plain"))
    numbers = [[[float(x) for x in line.split(",")] for line in lines] for lines in (expected, found)]
    assert len(numbers[0]) == 2
    np.testing.assert_allclose(numbers[1], numbers[0], atol=1e-5)


def test_batches_that_are_added_up_equal_one_batch(tmp_path: Path, of_two: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    arguments = [of_two / "plain.toml", "--data", of_two / "a.safetensors", of_two / "b.safetensors"]
    run(*arguments, "--out", one, "--set", "train.batch=4")
    run(*arguments, "--out", two, "--set", "train.batch=2", "--set", "train.accumulate=2")
    assert_same(one, two)
    assert_same(one, of_two / "added")


def test_sharded_modules_equal_whole_ones(of_two: Path) -> None:
    assert_same(of_two / "whole", of_two / "sharded")
    assert_same(of_two / "critics", of_two / "critics-sharded")
    assert difference(of_two / "whole", of_two / "critics") > 1e-3
    names = sorted(path.name for path in (of_two / "sharded" / "checkpoint-6").iterdir())
    assert names == ["checkpoint.json", "rank-0.pt", "rank-1.pt"]


def test_sharded_modules_resume(of_two: Path) -> None:
    assert (of_two / "again" / "loss.csv").read_bytes() == (of_two / "sharded" / "loss.csv").read_bytes()
    assert (of_two / "eight-again" / "loss.csv").read_bytes() == (of_two / "eight" / "loss.csv").read_bytes()
    parts = [torch.load(of_two / "eight" / "checkpoint-6" / f"rank-{rank}.pt", weights_only=True) for rank in range(2)]
    for part in parts:  # 6 x 4096 weights, each half of which has moments of 8 bits
        codes = part["moments"]["network"][0]["first"]
        assert codes.dtype == torch.uint8 and len(codes) == 6 * 4096 // 2


def test_a_parameter_without_a_gradient_is_not_changed(of_two: Path) -> None:
    assert_same(of_two / "plain", of_two / "spare")
    assert weights_of(of_two / "spare")[0]["spare"].tolist() == [1, 1]


def test_moments_of_8_bits(tmp_path: Path, clips: list[Path]) -> None:
    outs = [tmp_path / name for name in ("whole", "parts", "full")]
    file = config(tmp_path, train={"optimizer": "adamw8bit", "ema": 0.5}, options={"width": 1024})
    run(file, "--data", *clips, "--out", outs[0])
    run(file, "--data", *clips, "--out", outs[1], "--steps", 4)
    run(file, "--data", *clips, "--out", outs[1], "--resume")
    assert (outs[0] / "loss.csv").read_bytes() == (outs[1] / "loss.csv").read_bytes()
    assert_equal_weights(outs[0], outs[1])
    state = torch.load(outs[0] / "checkpoint-6" / "rank-0.pt", weights_only=True)
    assert state["moments"]["network"][0]["second"].dtype == torch.uint8
    run(file, "--data", *clips, "--out", outs[2], "--set", "train.optimizer=adamw")
    assert 0 < difference(outs[0], outs[2]) < 0.02


def test_half_precision(tmp_path: Path, clips: list[Path]) -> None:
    """Losses under autocast are near those in single precision; weights and moments stay in single precision."""
    one, half = tmp_path / "one", tmp_path / "half"
    run(config(tmp_path), "--data", *clips, "--out", one)
    run(config(tmp_path, train={"precision": "bf16"}), "--data", *clips, "--out", half)
    assert 0 < difference(one, half) < 2**-8
    state = torch.load(half / "checkpoint-6" / "rank-0.pt", weights_only=True)
    tensors = [*state["modules"]["network"].values(), *state["moments"]["network"][0].values()]
    assert {tensor.dtype for tensor in tensors} == {torch.float32}


def test_numbers_of_the_progress_line() -> None:
    import io

    from pskel.train.progress import Progress, duration

    stream = io.StringIO()
    progress = Progress(100, 4, stream)
    for done in range(1, 12):  # a step a second
        progress.step(done, 0.5, now=100.0 + done)
    lines = stream.getvalue().splitlines()
    assert lines == [
        "step 1/100, loss 0.5",
        "step 6/100, loss 0.5, 4 clips/s, 1 min left",
        "step 11/100, loss 0.5, 4 clips/s, 1 min left",
    ]
    assert [duration(s) for s in (5.4, 59.6, 3599, 3600, 7265)] == ["5 s", "1 min", "59 min", "1 h 0 min", "2 h 1 min"]
