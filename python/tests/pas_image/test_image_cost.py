"""Estimates of memory and operations: counts by hand of small modules, and the table of the command."""

from dataclasses import replace
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
pytest.importorskip("peft")
from pskel.models._cost import counted, recomputed_bytes, saved_bytes  # noqa: E402
from pskel.models.pas_image.config import TINY  # noqa: E402
from pskel.models.pas_image.cost import MODES, Cost, cost, main, measured  # noqa: E402
from torch.nn.functional import scaled_dot_product_attention  # noqa: E402


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
    from pskel.models.pas_image.cost import _FROZEN_MODELS
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


def test_the_command_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--tiny", "--rate", "0.001"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 12 and {line.count("|") for line in lines} == {5}
    assert lines[0] == "| 224x400, 2 frames, 6 cameras | all | adapters | lora, rank 16 |"
    assert "| time per clip at 0.001 T/s |" in lines[9]


def test_steps_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a GPU, which has 224x400 pixels."""
    monkeypatch.setattr("pskel.models.pas_image.cost._SIZE", (32, 56))
    seconds, peak = measured(replace(TINY, trained="lora", lora_rank=16), torch.device("cpu"))
    assert 0.0 < seconds < 600.0 and peak == 0


def test_wrong_options_are_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert main(["--rate", "0"]) == 1
    assert capsys.readouterr().err == "pskel.models.pas_image.cost: expected --rate above 0, found 0\n"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert main(["--measure"]) == 1
    assert capsys.readouterr().err == "pskel.models.pas_image.cost: expected a GPU for --measure, found none\n"
