"""AdamW with moments of 8 bits follows PyTorch's AdamW."""

import copy
import io
from typing import Any

import pytest

torch = pytest.importorskip("torch")
from pskel.models._adamw8bit import BLOCK, AdamW8bit, state_bytes  # noqa: E402


def test_small_tensors_equal_adamw() -> None:
    """Tensors of less than 4096 numbers have moments in full."""
    generator = torch.Generator().manual_seed(1)
    ours = [torch.nn.Parameter(torch.randn(size, generator=generator)) for size in ((), (7,), (31, 33))]
    theirs = copy.deepcopy(ours)
    optimizers = AdamW8bit(ours, lr=0.01, weight_decay=0.1), torch.optim.AdamW(theirs, lr=0.01, weight_decay=0.1)
    for _ in range(20):
        for one, other in zip(ours, theirs):
            one.grad = torch.randn(one.shape, generator=generator)
            other.grad = one.grad.clone()
        for optimizer in optimizers:
            optimizer.step()
    for one, other in zip(ours, theirs):
        assert float((one - other).detach().abs().max()) < 1e-6


def regression(optimizer: Any, model: Any, steps: int, batch: int | None) -> float:
    """Train a model on noise; returns its loss on all data."""
    data = torch.Generator().manual_seed(1)
    inputs = torch.randn(512, 64, generator=data)
    targets = 0.1 * torch.randn(512, 64, generator=data) @ torch.randn(64, 64, generator=data)
    for _ in range(steps):
        rows = slice(None) if batch is None else torch.randint(0, 512, (batch,), generator=data)
        optimizer.zero_grad()
        torch.autograd.backward((model(inputs[rows]) - targets[rows]).square().mean())
        optimizer.step()
    with torch.no_grad():
        return float((model(inputs) - targets).square().mean())


@pytest.mark.parametrize("batch", [None, 64])
def test_losses_follow_adamw(batch: int | None) -> None:
    torch.manual_seed(0)
    model = torch.nn.Sequential(torch.nn.Linear(64, 128), torch.nn.ReLU(), torch.nn.Linear(128, 64))
    other, start = copy.deepcopy(model), copy.deepcopy(model)
    expected = regression(torch.optim.AdamW(model.parameters(), lr=1e-3), model, 300, batch)
    assert regression(torch.optim.SGD(start.parameters(), lr=0.0), start, 1, batch) > 1.3 * expected
    assert regression(AdamW8bit(other.parameters(), lr=1e-3), other, 300, batch) == pytest.approx(expected, rel=0.01)


def moments(optimizer: Any, parameter: Any) -> tuple[Any, Any]:
    from pskel.models._adamw8bit import _read

    state = optimizer.state[parameter]
    return _read(state, "first"), _read(state, "second")


def test_second_moments_do_not_stop() -> None:
    """Gradients fall to a tenth: rounding to the nearest level would leave the second moments where they were."""
    generator = torch.Generator().manual_seed(2)
    parameter = torch.nn.Parameter(torch.zeros(64 * BLOCK))
    optimizer = AdamW8bit([parameter], lr=0.0)
    scale = torch.rand(64 * BLOCK, generator=generator) + 0.5
    expected = torch.zeros(64 * BLOCK)
    for step in range(600):
        gradient = scale * torch.randn(64 * BLOCK, generator=generator) * (1.0 if step < 200 else 0.1)
        if step % BLOCK:  # the largest number of a block keeps its scale
            gradient[::BLOCK] = 3.0
        parameter.grad = gradient
        optimizer.step()
        expected.mul_(0.999).addcmul_(gradient, gradient, value=0.001)
    ratios = (moments(optimizer, parameter)[1] / expected).log()
    # Each of 16 384 ratios has a deviation below 0.3, so that their mean has one below 0.0025.
    assert float(ratios.std()) < 0.3 and abs(float(ratios.exp().mean()) - 1.0) < 0.01


def test_first_moments_have_the_right_mean() -> None:
    generator = torch.Generator().manual_seed(3)
    parameter = torch.nn.Parameter(torch.zeros(16 * BLOCK + 100))  # the last block is not full
    optimizer = AdamW8bit([parameter], lr=0.0)
    expected, error = torch.zeros(len(parameter)), torch.zeros(len(parameter))
    for _ in range(400):
        parameter.grad = torch.randn(len(parameter), generator=generator)
        optimizer.step()
        expected.lerp_(parameter.grad, 0.1)
        error += moments(optimizer, parameter)[0] - expected
    mean = error / 400
    assert abs(float(mean.mean())) < 1e-3 and float(mean.abs().max()) < 0.02
    assert 0.1 < float(expected.std())


def test_a_small_gradient_beside_large_ones_takes_no_large_step() -> None:
    """A second moment that is rounded to 0 would divide by nearly 0."""
    parameter = torch.nn.Parameter(torch.zeros(16 * BLOCK))
    optimizer = AdamW8bit([parameter], lr=1.0, weight_decay=0.0)
    gradient = torch.full((16 * BLOCK,), 1e-6)
    gradient[::BLOCK] = 10.0
    for _ in range(10):
        before = parameter.detach().clone()
        parameter.grad = gradient.clone()
        optimizer.step()
        # AdamW moves each number by 1, the rate, as the gradient does not change.
        assert float((parameter - before).detach().abs().max()) < 1.1


def test_half_precision_has_weights_in_single() -> None:
    """Steps of 1e-4 are below the distance of numbers near 1 in bf16 (0.0078), and add up all the same."""
    generator = torch.Generator().manual_seed(4)
    start = 1.0 + torch.rand(2, 2048, generator=generator)
    half = torch.nn.Parameter(start.bfloat16())
    full = torch.nn.Parameter(half.detach().float())
    ours, theirs = AdamW8bit([half], lr=1e-4), torch.optim.AdamW([full], lr=1e-4)
    for _ in range(200):
        gradient = (1.0 + 0.1 * torch.randn(start.shape, generator=generator)).bfloat16()
        half.grad, full.grad = gradient, gradient.float()
        ours.step()
        theirs.step()
    master = ours.state[half]["master"]
    assert master.dtype is torch.float32 and torch.equal(half, master.bfloat16())
    assert float((master - full).detach().abs().max()) < 0.05 * 200 * 1e-4
    assert float((full - start).detach().mean()) == pytest.approx(-200 * 1e-4, rel=0.3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_states_are_restored(dtype: Any) -> None:
    generator = torch.Generator().manual_seed(5)
    gradients = [torch.randn(5000, generator=generator).to(dtype) for _ in range(8)]

    def run(optimizer: Any, parameter: Any, part: slice) -> None:
        for gradient in gradients[part]:
            parameter.grad = gradient.clone()
            optimizer.step()

    whole = torch.nn.Parameter(torch.ones(5000, dtype=dtype))
    run(AdamW8bit([whole], lr=1e-3), whole, slice(8))
    first = torch.nn.Parameter(torch.ones(5000, dtype=dtype))
    before = AdamW8bit([first], lr=1e-3)
    run(before, first, slice(3))
    file = io.BytesIO()
    torch.save({"optimizer": before.state_dict(), "parameter": first.detach()}, file)
    file.seek(0)
    saved = torch.load(file, weights_only=True)
    second = torch.nn.Parameter(saved["parameter"])
    after = AdamW8bit([second], lr=5e-2)
    after.load_state_dict(saved["optimizer"])
    run(after, second, slice(3, 8))
    assert after.param_groups[0]["lr"] == 1e-3 and torch.equal(second, whole)
    assert not torch.equal(first, whole)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("count", [100, 4096, 4500])
def test_bytes_of_the_state(count: int, dtype: Any) -> None:
    parameter = torch.nn.Parameter(torch.zeros(count, dtype=dtype))
    parameter.grad = torch.ones_like(parameter)
    optimizer = AdamW8bit([parameter])
    optimizer.step()
    tensors = [value for value in optimizer.state[parameter].values() if isinstance(value, torch.Tensor)]
    assert state_bytes(count, dtype) == sum(tensor.numel() * tensor.element_size() for tensor in tensors)
    master = 0 if dtype is torch.float32 else 4 * count
    expected = {100: 800, 4096: 2 * (4096 + 4 * 16), 4500: 2 * (4500 + 4 * 18)}[count]
    assert state_bytes(count, dtype) == master + expected


def test_parameters_without_gradients_stay() -> None:
    one, other = (torch.nn.Parameter(torch.ones(3)) for _ in range(2))
    one.grad = torch.ones(3)
    optimizer = AdamW8bit([one, other])
    optimizer.step()
    assert torch.equal(other.detach(), torch.ones(3)) and not torch.equal(one.detach(), torch.ones(3))
    assert other not in optimizer.state
