"""Estimates of memory and time of training."""

import json
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("peft")
from pas_clips import SIZES  # noqa: E402
from pskel.models._rig import PUBLISHED  # noqa: E402
from pskel.models.pas import Config, Network  # noqa: E402
from pskel.models.pas.cost import main  # noqa: E402
from pskel.models.pas.training.memory import RUNS, Run, cost  # noqa: E402

CONFIG = Config.parse(SIZES)
SMALL = PUBLISHED[0]._replace(frames=2, cameras=("A", "B", "C"), size=(32, 64))


def test_the_full_network() -> None:
    """4377 M parameters; 7.0 GB of kept and about 5 GB of recomputed activations; 4 calls' worth of operations."""
    found = cost(Run("all", "adamw8bit"), PUBLISHED[0])
    assert (found.trained, found.frozen) == (4_377_494_994, 0)
    assert found.state_bytes == pytest.approx(10 * found.trained, rel=0.005)
    assert found.kept_bytes == pytest.approx(7.0e9, rel=0.01) and 4.5e9 < found.recomputed_bytes < 5.5e9
    assert found.total_bytes() < 60e9 < 80e9
    assert 4 * 170e12 < found.operations < 4 * 200e12


@pytest.mark.parametrize("run", RUNS, ids=lambda run: f"{run.train}-{run.optimizer}")
def test_states_by_hand(run: Run) -> None:
    """18 bytes for a trained parameter, 10 with moments of 8 bits (and a little for scales), 2 for a frozen one."""
    found = cost(run, SMALL, CONFIG)
    with torch.device("meta"):
        sizes = {name: parameter.numel() for name, parameter in Network(CONFIG).named_parameters()}
    points = sum(count for name, count in sizes.items() if name.startswith("condition_pc_adapter."))
    image = sum(count for name, count in sizes.items() if name.startswith("condition_image_adapter."))
    total = sum(sizes.values())
    known = {"all": total, "adapters": points + image, "points": points}
    if run.train in known:
        assert (found.trained, found.frozen) == (known[run.train], total - known[run.train])
    else:
        assert found.trained > points and found.frozen == total - points
    if run.optimizer == "adamw":
        assert found.state_bytes == 18 * found.trained + 2 * found.frozen
    else:
        assert 10.0 * found.trained < found.state_bytes < 10.4 * found.trained  # small tensors have moments in full
    assert found.total_bytes(2) - found.total_bytes() == found.input_bytes + found.kept_bytes + found.recomputed_bytes


def test_what_is_kept_by_hand() -> None:
    """Blocks keep their inputs alone; a frame and camera more keeps as much more."""
    runs = [cost(Run("all"), SMALL._replace(frames=frames), CONFIG).kept_bytes for frames in (2, 3, 4)]
    assert runs[1] - runs[0] == pytest.approx(runs[2] - runs[1], rel=0.02)
    tokens, dim, texts = 8, 128, 154
    # For each image: tokens before each of four blocks, texts before the two joint blocks, and inputs of the adapter.
    blocks = 2 * (4 * tokens * dim + 2 * texts * dim)
    assert (runs[1] - runs[0]) / 3 > blocks


def test_measured_bytes_on_a_cpu() -> None:
    """What autograd keeps of real tensors is what the estimate counts."""
    from pskel.models._cost import saved_bytes
    from pskel.models.pas.training.memory import _inputs
    from pskel.models.pas.training.module import TrainedNetwork

    estimate = cost(Run("all"), SMALL, CONFIG)
    module, inputs = TrainedNetwork(Network(CONFIG).bfloat16()), _inputs(SMALL, CONFIG)
    module.network.checkpoint_activations = True
    out, kept = saved_bytes(lambda: module(inputs), [*module.parameters(), *module.buffers()])
    # Layer normalization keeps means in bf16 on a CPU, in f32 on other devices.
    assert out.shape == (1, 2, 3, 16, 4, 8) and kept == pytest.approx(estimate.kept_bytes, rel=1e-3)
    module.network.checkpoint_activations = False
    _, everything = saved_bytes(lambda: module(inputs), [*module.parameters(), *module.buffers()])
    assert everything > 2 * kept


def test_the_command_prints_a_table(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "sizes.json"
    path.write_text(json.dumps({**SIZES, "pos_embed_max_size": 32}))
    assert main(["--config", str(path), "--training", "--clips", "nuPlan", "--rate", "100"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "| 224x448, 10 frames, 8 cameras | all | all | adapters | points | points+lora:16 |"
    assert lines[2] == "| optimizer | adamw | adamw8bit | adamw | adamw | adamw |"
    assert [line.split(" | ")[0] for line in lines[3:]] == [
        "| parameters, trained and frozen",
        "| weights, gradients, moments",
        "| activations of a clip, kept; recomputed",
        "| sum for 1 clip; 2 clips",
        "| operations per clip",
        "| time per clip at 100 T/s",
    ]
    for arguments, message in (
        (["--rate", "0"], "expected --rate above 0, found 0"),
        (["--measure", "9"], "expected --measure of 1 to 5, found 9"),
        (["--measure", "1"], "expected a GPU for --measure, found none"),
    ):
        if torch.cuda.is_available() and arguments == ["--measure", "1"]:
            continue
        assert main(["--config", str(path), "--training", *arguments]) == 1
        assert capsys.readouterr().err == f"pskel.models.pas.cost: {message}\n"
