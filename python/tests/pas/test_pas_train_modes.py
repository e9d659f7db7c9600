"""What is trained: parts of the network, LoRA matrices, and the checkpoints that come of them."""

import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("peft")
safetensors = pytest.importorskip("safetensors.torch")
from pas_clips import SIZES  # noqa: E402
from pskel.models.pas import Config, Network, load  # noqa: E402
from pskel.models.pas.checkpoint import as_header, load_start, read_header  # noqa: E402
from pskel.models.pas.training.merge import main  # noqa: E402
from pskel.models.pas.training.modes import (  # noqa: E402
    TrainMode,
    full_weights,
    lora_layers,
    merged,
    prepare,
    trained_weights,
)
from pskel.models.pas.training.module import TrainedNetwork  # noqa: E402
from pskel.models.pas.training.step import Inputs  # noqa: E402

CONFIG = Config.parse(SIZES)
POINTS = "condition_pc_adapter."


def inputs(seed: int = 0, **changed: Any) -> Inputs:
    random = torch.Generator().manual_seed(seed)
    leading = 1, 2, 3

    def numbers(*shape: int) -> Any:
        return torch.randn(*leading, *shape, generator=random)

    values: dict[str, Any] = {
        "sample": numbers(16, 4, 8),
        "timestep": torch.full(leading, 700.0),
        "text": numbers(5, 40),
        "pooled": numbers(24),
        "layout": numbers(6, 32, 64),
        "points": numbers(20, 32, 64),
        "ids": numbers(13),
        "mask": torch.ones(1, 3, 3, dtype=torch.bool),
        "single_frames": torch.zeros(1, dtype=torch.bool),
    }
    return Inputs(**{**values, **changed})


def random_network(seed: int = 1) -> Network:
    """A network whose zero convolutions are not 0."""
    torch.manual_seed(seed)
    network = Network(CONFIG)
    for name, parameter in network.named_parameters():
        if "zero_convs" in name:
            torch.nn.init.normal_(parameter, std=0.3)
    return network


def predict(network: Network, **changed: Any) -> Any:
    with torch.no_grad():
        return TrainedNetwork(network)(inputs(**changed))


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint without an adapter of points."""
    path = tmp_path_factory.mktemp("base") / "start.safetensors"
    weights = {name: tensor for name, tensor in random_network().state_dict().items() if not name.startswith(POINTS)}
    safetensors.save_file(weights, path)
    return path


@pytest.mark.parametrize("train", ["all", "adapters", "points", "points+lora:4", "lora:2"])
@pytest.mark.parametrize("checkpointing", [False, True])
def test_step_0_predicts_what_the_base_predicts(base: Path, train: str, checkpointing: bool) -> None:
    # Frozen weights may have other kernels, which round otherwise.
    expected = predict(random_network().requires_grad_(train == "all"), points=None)
    network = load_start(base, CONFIG)
    prepare(network, TrainMode.parse(train))
    network.checkpoint_activations = checkpointing
    assert torch.equal(predict(network), expected)
    assert torch.equal(TrainedNetwork(network)(inputs()).detach(), expected)
    assert float((predict(network, seed=3) - expected).abs().max()) > 0.1


def test_a_new_adapter_is_random_and_closed(base: Path) -> None:
    torch.manual_seed(5)
    first = load_start(base, CONFIG)
    torch.manual_seed(5)
    again = load_start(base, CONFIG)
    adapter = first.condition_pc_adapter.state_dict()
    assert all(torch.equal(tensor, again.condition_pc_adapter.state_dict()[name]) for name, tensor in adapter.items())
    assert all((tensor == 0).all() == name.startswith("zero_convs") for name, tensor in adapter.items())


def test_an_adapter_of_the_start_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "whole.safetensors"
    weights = random_network().state_dict()
    safetensors.save_file(weights, path)
    assert all(torch.equal(tensor, weights[name]) for name, tensor in load_start(path, CONFIG).state_dict().items())
    del weights["condition_pc_adapter.zero_convs.0.bias"]
    safetensors.save_file(weights, path)
    with pytest.raises(ValueError, match="1 missing .condition_pc_adapter.zero_convs.0.bias."):
        load_start(path, CONFIG)


@pytest.mark.parametrize(
    ("train", "pattern"),
    [
        ("all", ".*"),
        ("adapters", r"condition_(image|pc)_adapter\..*"),
        ("points", r"condition_pc_adapter\..*"),
        ("lora:3", r"(\w+_)?transformer_blocks\..*\.lora_[AB]\.default\.weight"),
        ("points+lora", r"condition_pc_adapter\..*|.*\.lora_[AB]\..*"),
    ],
)
def test_gradients_reach_what_is_trained(train: str, pattern: str) -> None:
    network = random_network()
    prepare(network, TrainMode.parse(train), frozen_dtype=torch.bfloat16)
    module = TrainedNetwork(network)
    with torch.autocast("cpu", torch.bfloat16):
        loss = module(inputs()).float().square().mean()
    torch.autograd.backward(loss)
    for name, parameter in network.named_parameters():
        is_trained = re.fullmatch(pattern, name) is not None
        assert parameter.requires_grad == is_trained == (parameter.grad is not None), name
        assert parameter.dtype is (torch.float32 if is_trained else torch.bfloat16), name
    if "lora" in train:
        layers = {name.rpartition(".lora_A")[0] for name, _ in network.named_parameters() if ".lora_A." in name}
        linear = {name for name, part in random_network().named_modules() if isinstance(part, torch.nn.Linear)}
        assert layers == {name for name in linear if re.match(r"(\w+_)?transformer_blocks\.", name)}


def test_a_layout_stage_has_no_points() -> None:
    network = random_network()
    prepare(network, TrainMode.parse("all"), with_points=False)
    module = TrainedNetwork(network)
    torch.autograd.backward(module(inputs(points=None)).square().mean())
    for name, parameter in network.named_parameters():
        assert (parameter.grad is None) == name.startswith(POINTS), name
    with pytest.raises(ValueError, match="found none: the layout stage has no point adapter"):
        prepare(random_network(), TrainMode.parse("points"), with_points=False)


@pytest.mark.parametrize(
    "text", ["", "full", "all+points", "points+all", "lora:0", "lora:x", "lora:", "lora+lora:2", "points+adapters"]
)
def test_other_modes_are_rejected(text: str) -> None:
    expected = f"expected train of all, or adapters, points and lora:R joined by +, found {text!r}"
    with pytest.raises(ValueError, match=f"^{re.escape(expected)}$"):
        TrainMode.parse(text)


def trained_network(base: Path, train: str) -> Network:
    """A network whose trained parameters have changed."""
    torch.manual_seed(7)
    network = load_start(base, CONFIG)
    prepare(network, TrainMode.parse(train))
    for parameter in network.parameters():
        if parameter.requires_grad:
            parameter.data += 0.05 * torch.randn(parameter.shape)
    return network


@pytest.mark.parametrize("train", ["points", "adapters", "points+lora:4", "lora:2"])
def test_merged_checkpoints_predict_the_same(base: Path, tmp_path: Path, train: str, capsys: Any) -> None:
    mode, network = TrainMode.parse(train), trained_network(base, train)
    expected = predict(network)
    start = safetensors.load_file(base)
    if train != "points":  # what is trained alone has no adapter of points
        start |= {name: tensor for name, tensor in network.state_dict().items() if name.startswith(POINTS)}
    safetensors.save_file(start, tmp_path / "start.safetensors")
    header = {"config": asdict(CONFIG), "export": "trained", "lora_rank": mode.lora_rank}
    trained = {name: tensor.contiguous() for name, tensor in trained_weights(network.state_dict(), mode).items()}
    safetensors.save_file(trained, tmp_path / "trained.safetensors", as_header(header))
    files = {name: str(tmp_path / f"{name}.safetensors") for name in ("start", "trained", "out")}
    assert main(["--weights", files["start"], "--trained", files["trained"], "--out", files["out"]]) == 0
    count = len(random_network().state_dict())
    assert capsys.readouterr().out == f"merged {count} tensors: {files['out']}\n"
    about = read_header(files["out"])
    assert about == {**json.loads(json.dumps(header)), "export": "full"}
    found = load(files["out"], Config.parse(about["config"]))
    assert float((predict(found) - expected).abs().max()) < 1e-5 * float(expected.std())
    directly = merged(network.state_dict())
    assert {name: tensor.shape for name, tensor in directly.items()} == {
        name: tensor.shape for name, tensor in random_network().state_dict().items()
    }
    assert all(torch.equal(tensor, directly[name]) for name, tensor in found.state_dict().items())
    assert len(trained) < count + len(lora_layers(found)) and float((predict(random_network()) - expected).std()) > 0.01


def test_other_files_are_not_merged(base: Path, tmp_path: Path, capsys: Any) -> None:
    network = trained_network(base, "lora:2")
    weights = trained_weights(network.state_dict(), TrainMode.parse("lora:2"))
    start = random_network().state_dict()
    layer = "transformer_blocks.0.attn.to_q"
    with pytest.raises(ValueError, match=f"expected LoRA matrices of rank 2 .*, found no {layer}.lora_A.weight"):
        full_weights(start, {name: tensor for name, tensor in weights.items() if layer not in name}, CONFIG, 2)
    with pytest.raises(ValueError, match=r"found .*lora_A.weight of \[2, 128\]: \[3, 128\]"):
        full_weights(start, weights, CONFIG, 3)
    with pytest.raises(ValueError, match=r"found other of \[1\]: no such tensor"):
        full_weights(start, {"other": torch.ones(1)}, CONFIG, 0)
    assert main(["--weights", str(base), "--trained", str(base), "--out", str(tmp_path / "o.safetensors")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and error.strip().endswith(f"found no such header: {base}")
    assert main(["--weights", str(base), "--trained", str(base), "--out", str(tmp_path / "o.pth")]) == 1
    assert "expected --out with the suffix .safetensors" in capsys.readouterr().err


def test_counts_of_the_full_network() -> None:
    """4377 M parameters, 299 M of them in the adapter of points; LoRA of rank 16: 48.5 M, of attention alone 15.5 M."""
    with torch.device("meta"):
        network = Network(Config())
    sizes = {name: part for name, part in network.named_modules() if isinstance(part, torch.nn.Linear)}
    ranks = {name: sizes[name].in_features + sizes[name].out_features for name in lora_layers(network)}
    assert 16 * sum(ranks.values()) == 48_537_600
    assert 16 * sum(count for name, count in ranks.items() if ".attn" in name) == 15_482_880
    prepare(network, TrainMode.parse("points+lora:16"))
    trained = sum(parameter.numel() for parameter in network.parameters() if parameter.requires_grad)
    assert trained == 299_284_992 + 48_537_600
