"""Estimates of memory and operations: counts by hand of small modules, and the table of the command."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
pytest.importorskip("peft")
from pskel.models._cost import counted, recomputed_bytes, saved_bytes  # noqa: E402
from pskel.models.pas_image.config import TINY  # noqa: E402
from pskel.models._rig import PUBLISHED  # noqa: E402
from pskel.models.pas_image.cost import cost as inference_cost  # noqa: E402
from pskel.models.pas_image.cost import main  # noqa: E402
from pskel.models.pas_image.memory import MODES, Cost, cost, measured  # noqa: E402
from pskel.models.pas_image.presets import PRESETS  # noqa: E402
from torch.nn.functional import scaled_dot_product_attention  # noqa: E402

PAGE = Path(__file__).parents[3] / "docs/src/reference/pas.md"


@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_counts_of_a_small_network(device: str) -> None:
    with torch.device(device):
        first, second = torch.nn.Linear(3, 5), torch.nn.Linear(5, 7)
        x = torch.zeros(11, 3)

        def run() -> Any:
            return second(first(x).relu()).sum()

        _, operations = counted(run)
        _, both = counted(lambda: run().backward())
        parameters = [*first.parameters(), *second.parameters()]
        _, kept = saved_bytes(run, parameters)
    assert operations == 2 * 11 * (3 * 5 + 5 * 7)
    # Gradients of both weights, and of the second layer's input.
    assert both == operations + 2 * 11 * (3 * 5 + 2 * 5 * 7)
    assert kept == 4 * 11 * (3 + 5)  # the input and the hidden layer, each once


def test_attention_keeps_no_weights_of_pairs() -> None:
    query, key, value = (torch.zeros(1, 2, 100, 8, device="meta", requires_grad=True) for _ in range(3))
    out, kept = saved_bytes(lambda: scaled_dot_product_attention(query, key, value), [])
    assert out.shape == query.shape and kept == 4 * 4 * query.numel()
    torch.autograd.backward(out.sum())
    assert query.grad is not None and query.grad.shape == query.shape


def test_the_largest_recomputed_module() -> None:
    small, large = torch.nn.Linear(3, 3, device="meta"), torch.nn.Linear(3, 50, device="meta")
    x = torch.zeros(7, 3, device="meta")
    block = torch.nn.Sequential(large, torch.nn.Sigmoid())
    found = recomputed_bytes(lambda: block(small(x)), [small, block])
    assert found == 4 * 7 * (3 + 50)


def test_estimates_of_the_tiny_network() -> None:
    found = {trained: cost(trained, rank, TINY) for trained, rank in MODES}
    everything, adapters, lora = found["all"], found["adapters"], found["lora"]
    assert everything.frozen == 0 and adapters.trained + adapters.frozen == everything.trained
    matrices = lora.trained - adapters.trained
    assert matrices > 0 and lora.frozen == adapters.frozen
    # 10 transformers; per matrix pair, rank times the sum of inputs and outputs.
    per = sum(16 * (6 * 2 * c + 2 * (c + 24) + c + 8 * c + 4 * c + c) for c in (16, 32, 32, 32, 32, 32, 32, 32, 16, 16))
    assert matrices == per
    for each in found.values():
        assert each.checkpointed_bytes < each.activation_bytes
        assert 2 * each.call_operations < each.step_operations < 3.5 * each.call_operations
        assert each.state_bytes - each.state_bytes_8bit == 6 * each.trained
    assert adapters.step_operations < everything.step_operations


def test_bytes_of_the_state() -> None:
    """Of the full training in f32 with a copy in bf16, and of the frozen models in f32."""
    found = Cost(
        trained=10**9, frozen=10**8, activation_bytes=0, checkpointed_bytes=0, step_operations=0, call_operations=0
    )
    frozen = 4 * (83_653_863 + 123_060_480)
    assert found.state_bytes == 18 * 10**9 + 6 * 10**8 + frozen
    assert found.state_bytes_8bit == 12 * 10**9 + 6 * 10**8 + frozen


def test_the_frozen_models_have_the_published_sizes() -> None:
    from diffusers import AutoencoderKL
    from pskel.models.pas_image.memory import _FROZEN_MODELS
    from transformers import CLIPTextConfig, CLIPTextModel

    with torch.device("meta"):
        vae = AutoencoderKL(
            down_block_types=("DownEncoderBlock2D",) * 4,
            up_block_types=("UpDecoderBlock2D",) * 4,
            block_out_channels=(128, 256, 512, 512),
            layers_per_block=2,
        )
        text = CLIPTextModel(
            CLIPTextConfig(hidden_size=768, intermediate_size=3072, num_hidden_layers=12, num_attention_heads=12)
        )
    assert sum(p.numel() for module in (vae, text) for p in module.parameters()) == _FROZEN_MODELS


@pytest.mark.parametrize("arguments", [[], ["--training"]], ids=["inference", "training"])
def test_the_page_has_the_tables(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 0
    table = capsys.readouterr().out
    assert len(table.splitlines()) == (11 if arguments else 10) and table in PAGE.read_text()


def test_the_rate_is_in_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--tiny", "--rate", "0.001", "--training"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.count("|") for line in lines} == {5}
    assert lines[0] == "| 224x400, 2 frames, 6 cameras | all | adapters | lora, rank 16 |"
    assert "| time per clip at 0.001 T/s |" in lines[9]
    assert main(["--tiny", "--rate", "0.001"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "| | nuscenes, 6 cameras | nuplan, 8 cameras |"
    assert "| time per planning step at 0.001 T/s |" in lines[8]


def test_inference_costs_what_the_forward_pass_of_training_does() -> None:
    """A call with all conditions, as in training, is an evaluation and the encoding of both frames."""
    preset = PRESETS["pas-image-nuscenes"]
    found = inference_cost(preset, 6, TINY)
    forward = cost("all", 0, TINY)
    assert found.call_operations + 2 * found.frame_operations == forward.call_operations
    assert found.parameters == forward.trained
    assert found.step_operations == 40 * found.call_operations + 2 * found.frame_operations
    # Down blocks of 16, 32, 32 and 32 channels: latents of 28x50, halved and rounded up.
    places = [28 * 50, 14 * 25, 7 * 13, 4 * 7]
    assert found.frame_bytes == 2 * 6 * sum(c * n for c, n in zip((16, 32, 32, 32), places))
    assert found.message_bytes == 4 * 2 * 6 * 26 * 224 * 400
    # Cameras are items of a batch, except for the attention across them.
    assert inference_cost(preset, 8, TINY).frame_operations * 6 == found.frame_operations * 8
    assert [len(known.cameras) for known in PUBLISHED] == [6, 8]


def test_steps_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a GPU, which has 224x400 pixels."""
    monkeypatch.setattr("pskel.models.pas_image.memory._SIZE", (32, 56))
    seconds, peak = measured(replace(TINY, trained="lora", lora_rank=16), torch.device("cpu"))
    assert 0.0 < seconds < 600.0 and peak == 0


def test_wrong_options_are_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert main(["--rate", "0"]) == 1
    assert capsys.readouterr().err == "pskel.models.pas_image.cost: expected --rate above 0, found 0\n"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for arguments, message in (
        (["--measure", "--training"], "expected a GPU for --measure, found none"),
        (["--measure"], "expected --training with --measure, found none"),
    ):
        assert main(arguments) == 1
        assert capsys.readouterr().err == f"pskel.models.pas_image.cost: {message}\n"
