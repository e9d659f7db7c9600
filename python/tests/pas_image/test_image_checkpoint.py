"""Files of the image variant: weights of a training, and the folder of Stable Diffusion 1.5."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
pytest.importorskip("transformers")
pytest.importorskip("peft")
safetensors = pytest.importorskip("safetensors.torch")
from image_base import random_weights  # noqa: E402
from pskel.models.pas_image import load  # noqa: E402
from pskel.models.pas_image.base import base_config, expect_base, load_unet  # noqa: E402
from pskel.models.pas_image.checkpoint import (  # noqa: E402
    Training,
    create,
    header,
    is_trained,
    read_header,
    saved_tensors,
)
from pskel.models.pas_image.config import TINY, Config  # noqa: E402
from pskel.models.pas_image.network import Inputs  # noqa: E402

pytest_plugins = ["image_base"]

TRAINING = Training(2, (56, 104), 2.0)
CONFIGS = [
    TINY,
    replace(TINY, trained="adapters"),
    replace(TINY, trained="lora", lora_rank=2),
]


def save(network: Any, path: Path, config: Config) -> Path:
    tensors = {name: tensor.contiguous() for name, tensor in saved_tensors(network.state_dict(), config).items()}
    safetensors.save_file(tensors, path, header(config, TRAINING))
    return path


def predict(network: Any) -> Any:
    generator = torch.Generator().manual_seed(1)

    def normal(*shape: int) -> Any:
        return torch.randn(1, 2, 2, *shape, generator=generator)

    maps = normal(6, 56, 104), normal(20, 56, 104)
    with torch.inference_mode():
        return network(
            Inputs(
                sample=normal(4, 7, 13),
                timestep=torch.tensor([[100.0, 700.0]]),
                text=normal(77, 24),
                layout=maps[0],
                points=maps[1],
                ids=normal(13),
                mask=None,
                single_frames=None,
            )
        )


def trained(base: Path, config: Config) -> Any:
    """A network all of whose trained weights differ from the base's."""
    torch.manual_seed(1)
    network = create(config, base).eval()
    random_weights(network)
    for parameter in network.parameters():
        if parameter.requires_grad:
            parameter.data += 0.01 * torch.randn(parameter.shape)
    return network


@pytest.mark.parametrize("config", CONFIGS, ids=["all", "adapters", "lora"])
def test_what_is_trained_is_saved_and_read(base: Path, tmp_path: Path, config: Config) -> None:
    network = trained(base, config)
    path = save(network, tmp_path / "w.safetensors", config)
    assert read_header(path) == (config, TRAINING)
    loaded = load(path, None if config.trained == "all" else base)
    assert not loaded.training and loaded.config == config
    expected = predict(network)
    error = (predict(loaded) - expected).abs().max() / expected.std()
    assert error == 0 if config.trained != "lora" else error < 1e-5  # merged matrices round differently
    assert (predict(create(config, base).eval()) - expected).abs().max() > 0.01
    half = load(path, base, dtype=torch.bfloat16)
    assert {parameter.dtype for parameter in half.parameters()} == {torch.bfloat16}


@pytest.mark.parametrize("config", CONFIGS, ids=["all", "adapters", "lora"])
def test_trained_parameters(base: Path, config: Config) -> None:
    network = create(config, base)
    names = {name for name, parameter in network.named_parameters() if parameter.requires_grad}
    assert names == {name for name, _ in network.named_parameters() if is_trained(name, config)}
    own = ("layout_adapter.", "point_adapter.", "view_embedding.")
    kinds = {
        "own": {name for name, _ in network.named_parameters() if name.startswith(own)},
        "across": {name for name, _ in network.named_parameters() if re.search(r"\.(across_\w+|view)\.", name)},
        "lora": {name for name, _ in network.named_parameters() if ".lora_" in name},
    }
    every = {name for name, _ in network.named_parameters()}
    assert names == (every if config.trained == "all" else kinds["own"] | kinds["across"] | kinds["lora"])
    # 10 transformers, each with two attentions of four layers and two more.
    assert len(kinds["lora"]) == (10 * 10 * 2 if config.trained == "lora" else 0)
    assert len(kinds["across"]) == 10 * (2 + 2 * 9)


def test_lora_begins_as_the_base(base: Path) -> None:
    expected = predict(create(TINY, base).eval())
    assert torch.equal(predict(create(CONFIGS[2], base).eval()), expected)


def test_sizes_are_those_of_the_folder(base: Path, tmp_path: Path) -> None:
    assert base_config(base) == TINY
    published: dict[str, Any] = {
        "_class_name": "UNet2DConditionModel",
        "_diffusers_version": "0.6.0",
        "act_fn": "silu",
        "attention_head_dim": 8,
        "block_out_channels": [320, 640, 1280, 1280],
        "center_input_sample": False,
        "cross_attention_dim": 768,
        "down_block_types": ["CrossAttnDownBlock2D", "CrossAttnDownBlock2D", "CrossAttnDownBlock2D", "DownBlock2D"],
        "downsample_padding": 1,
        "flip_sin_to_cos": True,
        "freq_shift": 0,
        "in_channels": 4,
        "layers_per_block": 2,
        "mid_block_scale_factor": 1,
        "norm_eps": 1e-05,
        "norm_num_groups": 32,
        "out_channels": 4,
        "sample_size": 64,
        "up_block_types": ["UpBlock2D", "CrossAttnUpBlock2D", "CrossAttnUpBlock2D", "CrossAttnUpBlock2D"],
    }
    (tmp_path / "unet").mkdir()
    path = tmp_path / "unet" / "config.json"
    path.write_text(json.dumps(published))
    assert base_config(tmp_path) == Config()
    changes: list[tuple[dict[str, Any], str]] = [
        ({"use_linear_projection": True}, "expected use_linear_projection false, found true"),  # version 2
        ({"in_channels": 9, "out_channels": 4}, "expected out_channels 9, found 4"),  # inpainting
        ({"cross_attention_dim": [768]}, "expected cross_attention_dim of type int, found [768]"),
        ({"mid_block_type": None}, 'expected mid_block_type "UNetMidBlock2DCrossAttn", found null'),
    ]
    for changed, message in changes:
        path.write_text(json.dumps({**published, **changed}))
        with pytest.raises(ValueError, match=f"^{re.escape(message)}: {re.escape(str(path))}$"):
            base_config(tmp_path)
    for text in ("{", "[]"):
        path.write_text(text)
        with pytest.raises(ValueError, match=f"^expected .*JSON.*: {re.escape(str(path))}$"):
            base_config(tmp_path)


@pytest.mark.parametrize(
    ("missing", "text"),
    [
        ("unet", "unet"),
        ("unet/config.json", "unet/config.json"),
        ("vae/config.json", "vae/config.json"),
        ("text_encoder/model.safetensors", "text_encoder/*.safetensors or text_encoder/*.bin"),
        ("tokenizer", "tokenizer"),
    ],
)
def test_missing_parts_are_named(base: Path, tmp_path: Path, missing: str, text: str) -> None:
    copy = tmp_path / "base"
    shutil.copytree(base, copy)
    path = copy / missing
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(ValueError) as caught:
        expect_base(copy, with_unet=True)
    assert str(caught.value) == f"expected a folder of Stable Diffusion 1.5 with {text}, found none: {copy}"
    if missing.startswith("unet"):
        assert expect_base(copy, with_unet=False) == copy


def test_other_unets_are_refused(base: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError) as caught:
        load_unet(base, Config())
    found = (
        f"expected block_out_channels [320, 640, 1280, 1280], found [16, 32, 32, 32]: {base / 'unet' / 'config.json'}"
    )
    assert str(caught.value) == found
    copy = tmp_path / "base"
    shutil.copytree(base, copy)
    (path,) = (copy / "unet").glob("*.safetensors")
    tensors = safetensors.load_file(path)
    for kind, changed in (
        ("1 missing (conv_in.bias)", {name: tensor for name, tensor in tensors.items() if name != "conv_in.bias"}),
        ("1 unexpected (extra)", {**tensors, "extra": torch.zeros(1)}),
    ):
        safetensors.save_file(changed, path, {"format": "pt"})
        with pytest.raises(ValueError) as caught:
            load_unet(copy, TINY)
        expected = f"expected the weights of a UNet2DConditionModel, found {kind}: {copy / 'unet'}"
        assert str(caught.value) == expected
    path.write_bytes(b"damaged")
    with pytest.raises(ValueError, match=f"^expected a UNet2DConditionModel, found .*: {copy / 'unet'}$"):
        load_unet(copy, TINY)


def test_other_weights_are_refused(base: Path, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    network = create(CONFIGS[1], base)
    save(network, path, CONFIGS[1])
    with pytest.raises(ValueError) as caught:
        load(path)
    assert (
        str(caught.value) == f"expected the folder of Stable Diffusion 1.5 for weights of adapters, found none: {path}"
    )
    tensors = safetensors.load_file(path)
    count = len(tensors)
    removed = [name for name in tensors if name.startswith("view_embedding")]
    for name in removed:
        del tensors[name]
    tensors["extra"] = torch.zeros(1)
    safetensors.save_file(tensors, path, header(CONFIGS[1], TRAINING))
    expected = (
        f"expected the {count} tensors of the network, found 4 missing ({'; '.join(sorted(removed)[:3])}; ..), "
        f"1 additional (extra): {path}"
    )
    with pytest.raises(ValueError) as caught:
        load(path, base)
    names = re.compile(r"\((view_embedding.*?); \.\.\)")
    assert names.sub("", str(caught.value)) == names.sub("", expected)
    # LoRA matrices of another rank.
    save(create(CONFIGS[2], base), path, replace(CONFIGS[2], lora_rank=3))
    with pytest.raises(
        ValueError, match=r"of another shape \(unet.*lora_A.weight: expected \[3, 16\], found \[2, 16\]"
    ):
        load(path, base)
    for texts, message in [
        ({"format": "pt"}, "expected weights of pskel-pas-image, version 1, found pt, version None"),
        (
            {**header(TINY, TRAINING), "version": "2"},
            "expected weights of pskel-pas-image, version 1, found pskel-pas-image, version 2",
        ),
        ({**header(TINY, TRAINING), "config": '{"colour": 1}'}, "expected keys of the network, found colour"),
    ]:
        safetensors.save_file({"a": torch.zeros(1)}, path, texts)
        with pytest.raises(ValueError, match=f"^{re.escape(message)}: {re.escape(str(path))}$"):
            load(path, base)
    safetensors.save_file({"a": torch.zeros(1)}, path, {**header(TINY, TRAINING), "training": "{}"})
    with pytest.raises(ValueError, match="^expected config and training in the header, found KeyError"):
        load(path, base)
    path.write_bytes(b"hello, world")
    with pytest.raises(ValueError, match=f"^expected a file of safetensors, found .*: {re.escape(str(path))}$"):
        load(path, base)
    with pytest.raises(FileNotFoundError, match="none.safetensors"):
        load(tmp_path / "none.safetensors", base)
