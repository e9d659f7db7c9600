"""The image variant's network: before training it is Stable Diffusion 1.5, and its parts see what they should."""

from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
pytest.importorskip("transformers")
from image_base import random_weights  # noqa: E402
from pskel.models._rig import ring_mask  # noqa: E402
from pskel.models.pas_image import Conditions, Config, Network  # noqa: E402
from pskel.models.pas_image.base import load_unet  # noqa: E402
from pskel.models.pas_image.blocks import AcrossFrames, AcrossViews, Adapter  # noqa: E402
from pskel.models.pas_image.config import TINY  # noqa: E402
from pskel.models.pas_image.network import Inputs  # noqa: E402

pytest_plugins = ["image_base"]

B, T, V = 2, 2, 3
DIM = TINY.cross_attention_dim


def inputs(rows: int = 7, columns: int = 13, views: int = V, **changed: Any) -> Any:
    """Random inputs for latents of a size."""
    generator = torch.Generator().manual_seed(1)

    def normal(*shape: int) -> Any:
        return torch.randn(B, T, *shape, generator=generator)

    values = {
        "sample": normal(views, 4, rows, columns),
        "timestep": torch.tensor([[120.0, 981.0], [999.0, 0.0]]),
        "text": normal(views, 77, DIM),
        "layout": normal(views, 6, 8 * rows, 8 * columns).sigmoid(),
        "points": normal(views, 20, 8 * rows, 8 * columns).sigmoid(),
        "ids": normal(views, 13),
        "mask": ring_mask(views).expand(B, -1, -1),
        "single_frames": torch.tensor([False, True]),
    }
    return Inputs(**{**values, **changed})


@pytest.fixture(scope="module")
def network() -> Any:
    """A network whose every part has an effect."""
    torch.manual_seed(2)
    network = Network(TINY).eval()
    random_weights(network)
    return network


def run(network: Any, given: Any) -> Any:
    with torch.inference_mode():
        return network(given)


@pytest.mark.parametrize(("rows", "columns"), [(7, 13), (8, 16), (5, 9)])
def test_a_new_network_is_stable_diffusion(base: Path, rows: int, columns: int) -> None:
    """To the bit, with frames of different levels, odd sizes, and all conditions."""
    given = inputs(rows, columns)
    plain = diffusers.UNet2DConditionModel.from_pretrained(base / "unet").eval()
    new = Network(TINY, load_unet(base, TINY)).eval()
    with torch.inference_mode():
        timesteps = given.timestep[:, :, None].expand(B, T, V).flatten()
        expected = plain(given.sample.flatten(0, 2), timesteps, given.text.flatten(0, 2)).sample.view(
            given.sample.shape
        )
    assert expected.std() > 0.1
    assert torch.equal(run(new, given), expected)
    random_weights(new)
    assert (run(new, given) - expected).abs().max() > 0.01


def test_each_addition_matters() -> None:
    """Each part that is 0 before training changes the output once it is not, and only if its input is there."""
    torch.manual_seed(3)
    transformers = 3 + 1 + 2 * 3  # of TINY: down, mid, up
    parts = {"layout_adapter": 1, "point_adapter": 1, "view_embedding": 1} | dict.fromkeys(
        ("across_views", "across_frames"), transformers
    )
    for part, count in parts.items():
        network = Network(TINY).eval()
        given = inputs()
        before = run(network, given)
        changed = [module for name, module in network.named_modules() if name.endswith(part)]
        for module in changed:
            random_weights(module)
        after = run(network, given)
        assert len(changed) == count, part
        assert (after[0] - before[0]).abs().max() > 1e-3, part
        # The second clip is without attention across frames.
        assert torch.equal(after[1], before[1]) == (part == "across_frames"), part


def test_adapters_have_the_sizes_of_the_down_blocks(network: Any) -> None:
    """Also where a half is not whole: 28x50, 14x25, 7x13, 4x7."""
    assert network.config.block_out_channels == (16, 32, 32, 32)
    with torch.inference_mode():
        found = network.encode_layout(torch.zeros(1, 1, 1, 6, 224, 400))
    assert [tuple(x.shape[3:]) for x in found] == [(16, 28, 50), (32, 14, 25), (32, 7, 13), (32, 4, 7)]
    with torch.inference_mode():
        out = network(torch.zeros(1, 2, 1, 4, 28, 50), torch.zeros(1, 2), conditions(network, 28, 50))
    assert out.shape == (1, 2, 1, 4, 28, 50)


def conditions(network: Any, rows: int, columns: int) -> Conditions:
    """Conditions of a clip with one camera."""
    residuals = network.encode_layout(torch.rand(1, 2, 1, 6, 8 * rows, 8 * columns))
    return Conditions(residuals, torch.zeros(1, 2, 1, 77, DIM), network.encode_view(torch.zeros(1, 2, 1, 13)))


def test_depth_is_halved(network: Any) -> None:
    points = torch.rand(1, 1, 1, 20, 56, 104)
    halved = points.clone()
    halved[:, :, :, 3:] *= 0.5
    with torch.inference_mode():
        expected = network.point_adapter(halved.flatten(0, 2))
        found = network.encode_points(points)
    assert all(torch.equal(a.flatten(0, 2), b) for a, b in zip(found, expected)) and len(found) == 4


def test_views_see_the_same_row_of_neighbors() -> None:
    torch.manual_seed(4)
    block = AcrossViews(16, 2)
    random_weights(block)
    tokens, offset, mask = torch.randn(1, 2, 5, 3, 4, 16), torch.randn(1, 2, 5, 16), ring_mask(5).unsqueeze(0)
    other = tokens.clone()
    other[0, 1, 2, 1] *= -1.0  # second frame, third camera, second row
    with torch.inference_mode():
        changed = (block(other, offset, mask) - block(tokens, offset, mask)).abs().amax(-1) > 1e-7
        unmasked = (block(other, offset, None) - block(tokens, offset, None)).abs().amax(-1) > 1e-7
    expected = torch.zeros(1, 2, 5, 3, 4, dtype=torch.bool)
    expected[0, 1, 1:4, 1] = True
    assert torch.equal(changed, expected)
    expected[0, 1, :, 1] = True
    assert torch.equal(unmasked, expected)


def test_frames_see_the_same_pixel() -> None:
    torch.manual_seed(5)
    block = AcrossFrames(16, 2)
    random_weights(block)
    tokens, offset = torch.randn(1, 2, 3, 3, 4, 16), torch.randn(1, 2, 3, 16)
    other = tokens.clone()
    other[0, 0, 2, 1, 3] += 1.0
    with torch.inference_mode():
        before, after = block(tokens, offset), block(other, offset)
        swapped = block(tokens.flip(1), offset.flip(1)).flip(1)
    expected = torch.zeros(1, 2, 3, 3, 4, dtype=torch.bool)
    expected[0, :, 2, 1, 3] = True
    assert torch.equal((after != before).any(-1), expected)
    assert (swapped - before).abs().max() > 1e-3  # the order of frames matters


def test_the_order_of_cameras_does_not_matter(network: Any) -> None:
    given, order = inputs(views=4), [2, 0, 3, 1]
    moved = {name: getattr(given, name)[:, :, order] for name in ("sample", "text", "layout", "points", "ids")}
    mask = given.mask[:, order][:, :, order]
    found = run(network, inputs(views=4, **moved, mask=mask))
    expected = run(network, given)[:, :, order]
    assert (found - expected).abs().max() < 1e-4 * expected.std()
    wrong = run(network, inputs(views=4, **moved))
    assert (wrong - expected).abs().max() > 1e-2 * expected.std()


def test_attention_across_frames_is_switched_off_by_clip(network: Any) -> None:
    given = inputs()
    other = given.sample.clone()
    other[:, 0] += 1.0
    before, after = run(network, given), run(network, inputs(sample=other))
    assert (after[0, 1] != before[0, 1]).any()
    assert torch.equal(after[1, 1], before[1, 1])  # a clip of single frames


def test_conditions_of_frames_are_encoded_apart(network: Any) -> None:
    given = inputs(single_frames=None)
    with torch.inference_mode():
        parts = [
            Conditions.concatenate(
                [
                    Conditions(
                        tuple(
                            a + b
                            for a, b in zip(
                                network.encode_layout(given.layout[at]), network.encode_points(given.points[at])
                            )
                        ),
                        given.text[at],
                        network.encode_view(given.ids[at]),
                    )
                    for at in ((slice(clip, clip + 1), slice(frame, frame + 1)) for frame in range(T))
                ],
                dim=1,
            )
            for clip in range(B)
        ]
        found = network(given.sample, given.timestep, Conditions.concatenate(parts, dim=0), given.mask)
    expected = run(network, given)
    assert (found - expected).abs().max() < 1e-5 * expected.std()


def test_checkpointing_gives_the_same_gradients() -> None:
    gradients = []
    for is_checkpointed in (False, True):
        torch.manual_seed(6)
        network = Network(TINY)
        random_weights(network)
        if is_checkpointed:
            network.enable_checkpointing()
        network(inputs(5, 9)).square().mean().backward()
        found: dict[str, Any] = {name: parameter.grad for name, parameter in network.named_parameters()}
        gradients.append(found)
    assert all(gradient is not None and gradient.any() for gradient in gradients[0].values())
    for name, gradient in gradients[0].items():
        assert (gradients[1][name] - gradient).abs().max() <= 1e-5 * gradient.abs().max(), name


def test_half_precision_follows_the_module(network: Any) -> None:
    import copy

    half = copy.deepcopy(network).to(torch.bfloat16)
    given = inputs()
    found, expected = run(half, given), run(network, given)
    assert found.dtype is torch.bfloat16
    error = (found.float() - expected).square().mean().sqrt() / expected.std()
    assert 0.0 < error < 0.05, error


def test_copies_are_independent(network: Any) -> None:
    """A copy, as for averages of weights, does not use parts of the original."""
    import copy

    other, given = copy.deepcopy(network), inputs()
    expected = run(network, given)
    for parameter in network.parameters():
        assert all(parameter is not copied for copied in other.parameters())
    assert torch.equal(run(other, given), expected)


def test_the_full_network_has_the_published_sizes() -> None:
    with torch.device("meta"):
        network = Network(Config())
    counts = {"unet": 0, "added": 0, "layout_adapter": 0, "point_adapter": 0, "view_embedding": 0}
    for name, parameter in network.named_parameters():
        is_added = any(f".{part}." in name for part in ("view", "across_views", "across_frames"))
        counts["added" if is_added else name.partition(".")[0]] += parameter.numel()
    assert counts["unet"] == 859_520_964  # Stable Diffusion 1.5
    # Per transformer of C channels: 4 C^2 + C + 2 norms of C, and C/8 twice, for each kind; 1280 C + C for the view.
    channels = [320] * 5 + [640] * 5 + [1280] * 6
    assert counts["added"] == sum(2 * (4 * c * c + c + 2 * c + 2 * c // 8) + 1281 * c for c in channels)
    # The published T2I-Adapter has 3 channels, 77.4 M parameters.
    t2i = sum(p.numel() for p in diffusers.T2IAdapter(in_channels=3, adapter_type="full_adapter").parameters())
    zero = sum(c * c + c for c in Config().block_out_channels)
    for name, maps in (("layout_adapter", 6), ("point_adapter", 20)):
        assert counts[name] == t2i + (maps - 3) * 64 * 9 * 320 + zero
    assert counts["view_embedding"] == (13 * 256 + 1) * 1280 + 1281 * 1280


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"timestep": torch.zeros(2, 3)}, r"expected timestep of \[2, 2\] for the latents, found \[2, 3\]"),
        ({"mask": ring_mask(2).expand(2, -1, -1)}, r"expected mask of \[2, 3, 3\] for the latents, found \[2, 2, 2\]"),
        ({"text": torch.zeros(2, 2, 2, 77, DIM)}, r"expected text of \[2, 2, 3\] for the latents, found \[2, 2, 2\]"),
        ({"ids": torch.zeros(2, 1, 3, 13)}, r"expected view of \[2, 2, 3\] for the latents, found \[2, 1, 3\]"),
    ],
)
def test_inputs_of_other_windows_are_rejected(network: Any, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        run(network, inputs(**changed))


def test_calls_need_conditions(network: Any) -> None:
    with pytest.raises(ValueError, match="expected timestep and conditions with noisy latents, found none"):
        network(torch.zeros(1, 2, 1, 4, 7, 13))
    with pytest.raises(RuntimeError, match="expected a call of the whole network, found one of its UNet"):
        network.unet(torch.zeros(1, 4, 7, 13), 1, torch.zeros(1, 77, DIM), class_labels=torch.zeros(1, 64))


def test_adapters_begin_at_zero() -> None:
    torch.manual_seed(7)
    adapter = Adapter(6, TINY)
    with torch.inference_mode():
        residuals = adapter(torch.rand(1, 6, 56, 104))
        features = adapter.body(torch.rand(1, 6, 56, 104))
    assert all((residual == 0).all() for residual in residuals) and all(feature.std() > 0 for feature in features)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"block_out_channels": [16]}, "expected block_out_channels of at least 2 sizes, found [16]"),
        ({"block_out_channels": [16, 32]}, "expected block_out_channels in multiples of norm_num_groups 32, found 16"),
        ({"layers_per_block": 0}, "expected layers_per_block of at least 1, found 0"),
        ({"layers_per_block": 1.5}, "expected layers_per_block of type int, found 1.5"),
        ({"block_out_channels": "wide"}, 'expected block_out_channels of type list of int, found "wide"'),
        ({"prediction": "sample"}, "expected prediction of epsilon, velocity, found 'sample'"),
        ({"depth": "discrete"}, "expected depth of continuous, both, found 'discrete'"),
        ({"zero_snr": True}, "expected prediction velocity with zero_snr, found epsilon"),
        ({"trained": "lora"}, "expected lora_rank above 0 for trained lora alone, found 0 for lora"),
        ({"lora_rank": 4}, "expected lora_rank above 0 for trained lora alone, found 4 for all"),
        ({"colour": 1}, "expected keys of the network, found colour"),
        ([1], "expected a JSON object, found [1]"),
    ],
)
def test_bad_configurations_are_rejected(changed: Any, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        Config.parse(changed, "c.json")
    assert str(caught.value) == f"{message}: c.json"


def test_configurations_survive_json() -> None:
    import json

    config = Config.parse({"prediction": "velocity", "zero_snr": True, "trained": "lora", "lora_rank": 4})
    assert Config.parse(json.loads(config.to_json())) == config != Config()
