"""Two processes take the steps of one: with copies of the network (DDP), and with shards of it (FSDP)."""

from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
pytest.importorskip("peft")
if not torch.distributed.is_available() or not torch.distributed.is_gloo_available():
    pytest.skip("PyTorch has no gloo", allow_module_level=True)
from pas_base import write_base  # noqa: E402
from pas_clips import clip, narrow_posterior, write_sizes  # noqa: E402
from pas_processes import STEPS, Step, create, run  # noqa: E402


@pytest.fixture(scope="module", params=["all", "points+lora:2"])
def results(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Losses and weights of one process with both clips, and of two with one each."""
    folder = tmp_path_factory.mktemp("processes")
    narrow_posterior(write_base(folder / "base"))
    options = {"base": str(folder / "base"), "config": str(write_sizes(folder / "sizes.json")), "train": request.param}
    found: dict[str, Any] = {}
    of = create(options)
    optimizer = torch.optim.AdamW(of.players[0].groups, lr=1e-3)
    for count in range(1, STEPS + 1):
        found.setdefault("losses", []).append(one_step(of, optimizer, count - 1))
        found[f"one {count}"] = {name: tensor.detach().clone() for name, tensor in weights_of(of).items()}
    found["start"] = weights_of(create(options))
    torch.multiprocessing.spawn(run, (options, str(folder)), nprocs=2)
    found["ranks"] = [torch.load(folder / f"rank{rank}.pt") for rank in range(2)]
    return found


def one_step(of: Any, optimizer: Any, number: int) -> float:
    loss = Step(of)(of.draw([clip(0), clip(1)], number, 0, 0))
    torch.autograd.backward(loss)
    optimizer.step()
    optimizer.zero_grad()
    return float(loss.detach())


def weights_of(of: Any) -> Any:
    return of.weights({"network": of.network})[0]


@pytest.mark.parametrize("kind", ["ddp", "fsdp"])
def test_losses_equal_one_process(results: dict[str, Any], kind: str) -> None:
    each = [rank[kind][0] for rank in results["ranks"]]
    assert len(each[0]) == STEPS and each[0] != each[1]
    for number, expected in enumerate(results["losses"]):
        assert sum(losses[number] for losses in each) / 2 == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("kind", ["ddp", "fsdp"])
def test_weights_equal_one_process(results: dict[str, Any], kind: str) -> None:
    """Within 0.05 learning rates, but for numbers whose gradient is nearly 0, of which AdamW keeps the sign alone."""
    expect_close(results["ranks"][0][kind][1], results[f"one {STEPS}"], results["start"])
    for rank in results["ranks"]:
        for name, tensor in rank[kind][1].items():
            assert torch.equal(tensor, results["ranks"][0][kind][1][name]), name


def test_sharded_moments_of_8_bits_take_the_first_step_of_adamw(results: dict[str, Any]) -> None:
    expect_close(results["ranks"][0]["fsdp8"][1], results["one 1"], results["start"])


def expect_close(found: Any, expected: Any, start: Any) -> None:
    assert found.keys() == expected.keys()
    moved, wrong, total = 0, 0, 0
    for name, tensor in expected.items():
        moved += int((tensor != start[name]).sum())
        wrong += int(((found[name] - tensor).abs() > 0.05 * 1e-3).sum())
        total += tensor.numel()
        assert float((found[name] - tensor).abs().max()) < 2.1 * STEPS * 1e-3, name
    assert moved > 0.05 * total and wrong < 1e-4 * moved, (moved, wrong, total)


def test_blocks_are_sharded_one_by_one(results: dict[str, Any]) -> None:
    """The tiny network has two joint blocks, and one each over cameras and frames; the rest is a unit, too."""
    for rank in results["ranks"]:
        assert rank["units"] == [
            *["FSDPJointTransformerBlock"] * 2,
            *["FSDPSelfAttentionBlock"] * 2,
            "FSDPTrainedNetwork",
        ]
