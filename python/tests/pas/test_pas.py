"""The *Point as Skeleton* video network equals the authors' on their inputs; only their checkpoints load."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import Run

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
safetensors = pytest.importorskip("safetensors.torch")
from pskel.models.pas import Conditions, Config, Network, added_time_ids, load  # noqa: E402

SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
FIXTURE = Path(os.environ.get("PSKEL_FIXTURES", SHARED / "fixtures")) / "pas-network"
WEIGHTS = FIXTURE / "weights.safetensors"
needs_fixture = pytest.mark.skipif(not FIXTURE.exists(), reason="pas-network is not there (set PSKEL_SHARED)")

SMALL: dict[str, Any] = {
    "num_layers": 2,
    "num_attention_heads": 2,
    "attention_head_dim": 16,
    "dual_attention_layers": [0],
    "crossview_block_layers": [0],
    "temporal_block_layers": [1],
    "sample_size": 16,
    "pos_embed_max_size": 24,
    "joint_attention_dim": 40,
    "caption_projection_dim": 32,
    "pooled_projection_dim": 24,
    "condition_image_adapter_config": {"in_channels": 6, "channels": [32], "is_downblocks": [True]},
    "condition_pc_adapter_config": {"in_channels": 20, "channels": [32], "is_downblocks": [True]},
}


@pytest.fixture(scope="module")
def config() -> Config:
    return Config.read(FIXTURE / "config.json")


@pytest.fixture(scope="module")
def network(config: Config) -> Network:
    return load(WEIGHTS, config)


@pytest.fixture(scope="module")
def io() -> Any:
    return safetensors.load_file(FIXTURE / "io.safetensors")


def inputs(io: Any, layout: Any = None) -> list[Any]:
    """The arguments of ``encode_conditions``."""
    points = torch.cat([io["condition_clr_tensor"], io["condition_depth_tensor"]], dim=3)
    layout = io["condition_image_tensor"] if layout is None else layout
    return [io["encoder_hidden_states"], io["pooled_projections"], layout, points, io["added_time_ids"]]


def predict(network: Network, io: Any, conditions: Conditions, **options: Any) -> Any:
    """Predict the velocity of the fixture's latents."""
    with torch.inference_mode():
        return network(io["sample"], io["timestep"], conditions, io["crossview_attention_mask"], **options)


def encode(network: Network, arguments: list[Any]) -> Conditions:
    with torch.inference_mode():
        return network.encode_conditions(*arguments)


def error(found: Any, expected: Any, scale: Any) -> float:
    """Maximum error in standard deviations of a tensor."""
    return float((found - expected).abs().max() / scale.std())


@needs_fixture
def test_outputs_equal_the_authors(network: Network, io: Any) -> None:
    conditions = encode(network, inputs(io))
    grey = encode(network, inputs(io, torch.full_like(io["condition_image_tensor"], 0.1255)))
    off = torch.ones(2, dtype=torch.bool)
    found = {
        "expected": predict(network, io, conditions),
        "expected_grey_layout": predict(network, io, grey),
        "expected_disabled": predict(network, io, conditions, disable_crossview=off, disable_temporal=off),
    }
    errors = {name: error(output, io[name], io[name]) for name, output in found.items()}
    assert max(errors.values()) < 1e-4, errors


@needs_fixture
def test_attention_is_switched_off_by_clip(network: Network, io: Any) -> None:
    off = torch.tensor([False, True])
    output = predict(network, io, encode(network, inputs(io)), disable_crossview=off, disable_temporal=off)
    assert error(output[0], io["expected"][0], io["expected"]) < 1e-4
    assert error(output[1], io["expected_disabled"][1], io["expected"]) < 1e-4


@needs_fixture
def test_a_mask_hides_cameras(network: Network, io: Any) -> None:
    conditions = encode(network, inputs(io))
    with torch.inference_mode():
        all_seen = network(io["sample"], io["timestep"], conditions, torch.ones(2, 3, 3))
        unmasked = network(io["sample"], io["timestep"], conditions)
    assert error(all_seen, unmasked, unmasked) < 1e-4
    assert error(unmasked, io["expected"], unmasked) > 1e-2


@needs_fixture
def test_conditions_are_encoded_once(network: Network, io: Any) -> None:
    conditions = encode(network, inputs(io))
    later = {**io, "sample": io["sample"] * 0.5, "timestep": io["timestep"] * 0.5}
    for call in (io, later):
        again = encode(network, inputs(io))
        assert torch.equal(predict(network, call, conditions), predict(network, call, again))


@needs_fixture
@pytest.mark.parametrize("dim", [0, 1])
def test_grouping_of_frames_does_not_change_conditions(network: Network, io: Any, dim: int) -> None:
    arguments = inputs(io)
    parts = [encode(network, [x.narrow(dim, i, 1) for x in arguments]) for i in range(arguments[0].shape[dim])]
    joined, whole = Conditions.concatenate(parts, dim), encode(network, arguments)
    for name in ("text", "pooled", "view"):
        assert torch.equal(getattr(joined, name), getattr(whole, name)), name
    assert len(joined.residuals) == len(whole.residuals) == 2
    assert all(torch.equal(a, b) for a, b in zip(joined.residuals, whole.residuals))


@needs_fixture
def test_half_precision_follows_the_module(config: Config, network: Network, io: Any) -> None:
    half = load(WEIGHTS, config, dtype=torch.bfloat16)
    output = predict(half, io, encode(half, inputs(io)))
    assert output.dtype is torch.bfloat16
    assert (output.float() - io["expected"]).pow(2).mean().sqrt() < 0.02 * io["expected"].std()


@needs_fixture
def test_ids_equal_the_authors() -> None:
    ids = safetensors.load_file(FIXTURE / "ids.safetensors")
    fps, poses = float(ids["fps"]), ids["ego_transforms"]

    def numbers(global_from_ego: Any, **options: Any) -> Any:
        cameras = ids["camera_intrinsics"], ids["image_size"], ids["camera_transforms"]
        return added_time_ids(*cameras, global_from_ego, fps, **options)

    found = numbers(poses[:, :, :6])
    expected = torch.cat([ids["expected_camera_ids"], ids["expected_action_ids"]], dim=-1)
    assert found.dtype is torch.float32 and (found[..., 0] == fps).all()
    assert (found[..., 1:] - expected).abs().max() < 1e-5
    assert torch.equal(numbers(poses[:, :, :1]), found)
    assert torch.equal(numbers(poses[:, :, :6], with_fps=False), found[..., 1:])


def test_motion_needs_two_frames() -> None:
    eye = torch.eye(4).expand(1, 1, 1, 4, 4)
    with pytest.raises(ValueError, match="expected at least 2 frames for the motion of the ego, found 1"):
        added_time_ids(eye[..., :3, :3], torch.ones(1, 1, 1, 2), eye, eye, 2.0)


@needs_fixture
@pytest.mark.parametrize("name", ["nuscenes.json", "nuplan.json"])
def test_published_checkpoints_fit(name: str) -> None:
    published = json.loads((FIXTURE / name).read_text())
    config = Config.parse(published["config"], name)
    assert config == Config()
    with torch.device("meta"):
        network = Network(config)
    shapes = {name: list(tensor.shape) for name, tensor in network.state_dict().items()}
    assert len(shapes) == 1505 and shapes == published["state_dict"]
    assert sum(parameter.numel() for parameter in network.parameters()) == published["parameters"]


@pytest.fixture(scope="module")
def small() -> Network:
    torch.manual_seed(1)
    return Network(Config.parse(SMALL)).eval()


def save_archive(weights: Any, path: Path) -> None:
    torch.save(weights, path)


def save_legacy(weights: Any, path: Path) -> None:
    torch.save(weights, path, _use_new_zipfile_serialization=False)


def save_safetensors(weights: Any, path: Path) -> None:
    safetensors.save_file(weights, path)


@pytest.mark.parametrize(
    ("file", "save"),
    [("w.pth", save_archive), ("w.pt", save_legacy), ("w.safetensors", save_safetensors)],
)
def test_formats_of_checkpoints(small: Network, tmp_path: Path, file: str, save: Callable[[Any, Path], None]) -> None:
    save(small.state_dict(), tmp_path / file)
    loaded = load(tmp_path / file, small.config)
    assert not loaded.training and next(loaded.parameters()).requires_grad
    weights = loaded.state_dict()
    assert weights.keys() == small.state_dict().keys()
    assert all(torch.equal(weights[name], tensor) for name, tensor in small.state_dict().items())


def test_other_tensors_are_rejected(small: Network, tmp_path: Path) -> None:
    weights = small.state_dict()
    count = len(weights)
    missing = [name for name in weights if name.startswith("time_mixers") or name.startswith("view_embedding")]
    for name in missing:
        del weights[name]
    weights["extra.weight"] = torch.zeros(1)
    weights["proj_out.bias"] = torch.zeros(3, 4)
    path = tmp_path / "other.pth"
    torch.save(weights, path)
    expected = (
        f"expected the {count} tensors of the network, found {len(missing)} missing ({'; '.join(missing[:3])}; ..), "
        f"1 additional (extra.weight), 1 of another shape (proj_out.bias: expected [64], found [3, 4]): {path}"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(expected)}$"):
        load(path, small.config)


@pytest.mark.parametrize(
    ("file", "content", "found"),
    [
        ("text.pth", b"hello, world", "expected a checkpoint of tensors, found a file that begins with b'hello, world'"),
        ("empty.pth", b"", "expected a checkpoint of tensors, found a file that begins with b''"),
        ("half.pth", b"PK\x03\x04 and no more", "expected a checkpoint of tensors, found a damaged archive"),
        ("text.safetensors", b"hello, world", "expected a file of safetensors, found "),
        ("list.pth", [1.0], "expected a dictionary of tensors, found list"),
        ("nested.pth", {"epoch": 3}, "expected a dictionary of tensors, found 'epoch' of int"),
        ("object.pth", {"path": Path("x")}, "expected a checkpoint of tensors, found objects of other types"),
    ],
)
def test_other_files_are_rejected(small: Network, tmp_path: Path, file: str, content: Any, found: str) -> None:
    path = tmp_path / file
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        torch.save(content, path)
    with pytest.raises(ValueError, match=f"^{re.escape(found)}.*: {re.escape(str(path))}$"):
        load(path, small.config)


def test_missing_files_are_named(small: Network, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="none.pth"):
        load(tmp_path / "none.pth", small.config)


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ({"colour": 1}, "expected keys of the network, found colour"),
        (
            {"condition_pc_adapter_config": {**SMALL["condition_pc_adapter_config"], "gate": 1}},
            "expected keys of the network, found condition_pc_adapter_config.gate",
        ),
        ({"num_layers": 2.5}, "expected num_layers of type int, found 2.5"),
        ({"num_layers": 0}, "expected num_layers of at least 1, found 0"),
        ({"mixer_type": "Mixer"}, 'expected mixer_type "AlphaBlender", found "Mixer"'),
        ({"temporal_block_layers": [2]}, "expected increasing temporal_block_layers below 2, found [2]"),
        ({"temporal_block_layers": ["1"]}, 'expected temporal_block_layers of type list of int, found ["1"]'),
        ({"caption_projection_dim": 64}, "expected caption_projection_dim 32, found 64"),
        (
            {"projection_class_embeddings_input_dim": 100},
            "expected projection_class_embeddings_input_dim of a multiple of 256, found 100",
        ),
        ({"condition_image_adapter_config": 6}, "expected a JSON object condition_image_adapter_config, found 6"),
        (
            {"condition_image_adapter_config": {"in_channels": 3, "channels": [32], "is_downblocks": [True]}},
            "expected condition_image_adapter_config.in_channels 6, found 3",
        ),
    ],
)
def test_bad_configurations_are_rejected(tmp_path: Path, values: dict[str, Any], found: str) -> None:
    path = tmp_path / "config.json"
    path.write_text(json.dumps({**SMALL, **values}))
    with pytest.raises(ValueError, match=f"^{re.escape(found)}.*: {re.escape(str(path))}$"):
        Config.read(path)


def test_configurations_are_json(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    for text in ("{", "[]"):
        path.write_text(text)
        with pytest.raises(ValueError, match=f"^expected .*JSON.*: {re.escape(str(path))}$"):
            Config.read(path)


def test_inputs_of_other_windows_are_rejected(small: Network) -> None:
    conditions = encode(
        small,
        [
            torch.zeros(1, 2, 3, 5, 40),
            torch.zeros(1, 2, 3, 24),
            torch.zeros(1, 2, 3, 6, 32, 32),
            torch.zeros(1, 2, 3, 20, 32, 32),
            torch.zeros(1, 2, 3, 13),
        ],
    )
    with torch.inference_mode():
        assert small(torch.zeros(1, 2, 3, 16, 4, 4), torch.zeros(1, 2, 3), conditions).shape == (1, 2, 3, 16, 4, 4)
        with pytest.raises(ValueError, match=r"expected timestep of \[1, 2, 3\] .*, found \[1, 2\]"):
            small(torch.zeros(1, 2, 3, 16, 4, 4), torch.zeros(1, 2), conditions)
        with pytest.raises(ValueError, match=r"expected conditions of \[1, 3, 3\] .*, found \[1, 2, 3\]"):
            small(torch.zeros(1, 3, 3, 16, 4, 4), torch.zeros(1, 3, 3), conditions)


def test_a_missing_package_names_the_extra(run: Run) -> None:
    done = run("-c", "import sys; sys.modules['diffusers'] = None; import pskel.models.pas", check=False)
    assert done.returncode == 1 and "pip install 'pskel[pas]'" in done.stderr, done.stderr
