"""The task of the video network for the training harness: batches, draws, losses, and what inference loads."""

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
safetensors = pytest.importorskip("safetensors.torch")
from pas_base import write_base  # noqa: E402
from pas_clips import clip, narrow_posterior, write_sizes  # noqa: E402
from pskel.models.pas import Config, load  # noqa: E402
from pskel.models.pas.checkpoint import read_header  # noqa: E402
from pskel.models.pas.task import Drawn, PasTask, recipe, task  # noqa: E402
from pskel.models.pas.text import TextEncoder  # noqa: E402
from pskel.models.pas.training.draws import Draws  # noqa: E402
from pskel.models.pas.training.presets import PRESETS, configuration, main  # noqa: E402
from pskel.models.pas.training.sample import sample  # noqa: E402
from pskel.models.pas.training.step import StepOptions, Texts, loss_of, noisy_inputs  # noqa: E402
from pskel.train.config import Config as TrainConfig  # noqa: E402
from pskel.train.config import TrainOptions  # noqa: E402
from pskel.train.errors import DataError  # noqa: E402

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Options of a tiny network."""
    folder = tmp_path_factory.mktemp("task")
    base = write_base(folder / "base")
    narrow_posterior(base)
    return {"base": str(base), "config": str(write_sizes(folder / "sizes.json"))}


def create(files: dict[str, Any], harness: TrainOptions = TrainOptions(), **options: Any) -> PasTask:
    torch.manual_seed(0)
    return task({**files, **options}, harness)


@pytest.fixture(scope="module")
def tiny(files: dict[str, Any]) -> PasTask:
    return create(files)


def same(one: Any, other: Any) -> bool:
    return all(torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b for a, b in zip(one, other, strict=True))


def step(of: PasTask, drawn: Drawn, optimizer: Any) -> float:
    """Take a step as the harness does; returns the loss."""
    of.network.train()
    loss, numbers = of.loss("network", drawn, {"network": of.network}, CPU)
    assert numbers.keys() == {"sigma"} and 0.0 < numbers["sigma"] <= 1.0
    optimizer.zero_grad()
    torch.autograd.backward(loss)
    optimizer.step()
    return float(loss.detach())


def test_a_resumed_step_has_the_same_bits(files: dict[str, Any], tmp_path: Path) -> None:
    clips = [clip(0), clip(1)]

    def run(of: PasTask, optimizer: Any, steps: range) -> list[float]:
        return [step(of, of.draw(clips, number, 3, 0), optimizer) for number in steps]

    whole = create(files)
    expected = run(whole, torch.optim.AdamW(whole.players[0].groups, lr=1e-3), range(4))
    first = create(files)
    optimizer = torch.optim.AdamW(first.players[0].groups, lr=1e-3)
    assert run(first, optimizer, range(2)) == expected[:2]
    torch.save({"module": first.network.state_dict(), "optimizer": optimizer.state_dict()}, tmp_path / "checkpoint.pt")
    saved = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    torch.manual_seed(99)
    second = task(files, TrainOptions())
    second.network.load_state_dict(saved["module"])
    second.load_state(first.state())
    resumed = torch.optim.AdamW(second.players[0].groups, lr=1e-3)
    resumed.load_state_dict(saved["optimizer"])
    assert run(second, resumed, range(2, 4)) == expected[2:]
    weights = second.network.state_dict()
    assert all(torch.equal(tensor, weights[name]) for name, tensor in whole.network.state_dict().items())
    assert len(set(expected)) == 4


def test_draws_depend_on_seed_step_and_place(tiny: PasTask) -> None:
    clips = [clip(0), clip(1)]
    draws = tiny.draw(clips, 5, 7, 0).draws
    assert same(draws, tiny.draw(clips, 5, 7, 0).draws)
    alone = [tiny.draw([each], 5, 7, rank).draws for rank, each in enumerate(clips)]
    assert same(draws, Draws.concatenate(alone))
    for other in (tiny.draw(clips, 6, 7, 0), tiny.draw(clips, 5, 8, 0), tiny.draw(clips, 5, 7, 1)):
        assert not any(torch.equal(a, b) for a, b in zip(draws, other.draws))
    assert not any(torch.equal(a[0], a[1]) for a in draws)


def test_draws_have_their_distributions() -> None:
    draws = Draws.sample(torch.Generator().manual_seed(1), 4000, (2, 1, 1, 2, 2))
    normal = ("posterior_noise", "noise", "level", "input_scale", "input_offset")
    assert draws.noise.shape == (4000, 2, 1, 1, 2, 2) and draws.level.shape == (4000, 2)
    for name in normal:
        values = getattr(draws, name)
        assert abs(float(values.mean())) < 0.06 and abs(float(values.std()) - 1.0) < 0.05, name
    for name in (name for name in Draws._fields if name not in normal):
        values = getattr(draws, name)
        assert values.shape == (4000,) and 0.0 <= float(values.min()) < 0.01 and 0.99 < float(values.max()) < 1.0, name
        assert abs(float(values.mean()) - 0.5) < 0.025, name


def test_batches_have_the_order_of_the_network(files: dict[str, Any]) -> None:
    """nuScenes: front left, front, front right, back right, back, back left."""
    tiny = create(files)
    names = ("CAM_BACK", "CAM_FRONT", "CAM_BACK_LEFT", "CAM_FRONT_LEFT", "CAM_BACK_RIGHT", "CAM_FRONT_RIGHT")
    base = clip(0)
    parts = {name: torch.cat([getattr(base, name)] * 2, dim=1) for name in ("color", "bins", "boxes", "map", "images")}
    parts["images"] = torch.arange(6, dtype=torch.uint8).view(1, 6, 1, 1, 1).expand(parts["images"].shape)
    cameras = torch.cat([base.cameras] * 2, dim=1).clone()
    cameras[:, :, 3] = torch.arange(6.0)
    sizes = torch.tensor([[900 + view, 1600] for view in range(6)])
    captions = (tuple(f"text {view}" for view in range(5)) + ("",),) * 2
    ring = clip(names=names, cameras=cameras, original_sizes=sizes, captions=captions, **parts)
    batch = tiny.draw([ring], 0, 0, 0).batch
    order = [3, 1, 5, 4, 0, 2]
    assert batch.images[0, :, :, 0, 0, 0].tolist() == [order] * 2
    assert batch.ids[0, :, :, 8].tolist() == [[float(view) for view in order]] * 2  # position, forward
    fractions = [0.8 * 1600 / (900 + view) for view in order]
    assert batch.ids[0, 0, :, 1].tolist() == pytest.approx(fractions)
    assert [batch.texts[i] for i in batch.caption[0, 0]] == ["text 3", "text 1", "", "text 4", "text 0", "text 2"]
    assert batch.texts[0] == "" and batch.mask[0].sum(1).tolist() == [3] * 6
    assert batch.mask[0, 0].tolist() == [True, True, False, False, False, True]


def test_numbers_of_batches(tiny: PasTask) -> None:
    """At 5 Hz, 0.9 m per frame are 16.2 km/h. Poses are far from the origin: ``float32`` has steps of 0.25 m there."""
    ids = tiny.draw([clip(frames=3)], 0, 0, 0).batch.ids
    assert ids.shape == (1, 3, 3, 13) and (ids[..., 0] == 5.0).all()
    assert ids[0, 0, 0, 1:5].tolist() == pytest.approx([0.8 * 16 / 9, 1.4, 0.5, 0.5])
    distance = math.hypot(0.9, 0.02)
    assert ids[0, :, 0, 11].tolist() == pytest.approx([distance * 5 * 3.6] * 3, rel=1e-5)
    assert ids[0, :, 0, 12].tolist() == pytest.approx([0.01 / distance * 2.7 * 14] * 3, rel=1e-5)


def test_numbers_follow_the_preset(files: dict[str, Any]) -> None:
    cases: tuple[tuple[dict[str, Any], list[float]], ...] = (
        ({"preset": "nuplan"}, [0.8 * 16 / 9, 0.0, 0.5, 1.4]),
        ({"preset": "nuplan", "camera_numbers": "fx,fy,cx,cy"}, [0.8 * 16 / 9, 1.4, 0.5, 0.5]),
        ({"preset": "paper-nuplan"}, [0.8 * 16 / 9, 1.4, 0.5, 0.5]),
    )
    for options, expected in cases:
        of = create(files, **options)
        assert of.draw([clip()], 0, 0, 0).batch.ids[0, 0, 0, 1:5].tolist() == pytest.approx(expected)
        (header,) = of.weights({"network": of.network})[1].values()
        assert json.loads(header)["camera_numbers"] == of.camera_numbers


def test_losses_are_those_of_the_step(tiny: PasTask, files: dict[str, Any]) -> None:
    """The loss of a batch, with captions encoded, latents and inputs computed here."""
    drawn = tiny.draw([clip(0), clip(1)], 0, 0, 0)
    assert drawn.batch.texts == ("", "Rain. Night", "Sun")
    encode = TextEncoder.load(Path(files["base"]), channels=40, pooled_channels=24)
    tokens, pooled = zip(*[encode(text) for text in drawn.batch.texts])
    texts = Texts(torch.stack(tokens).clone(), torch.stack(pooled).clone())
    mean, std = tiny._codec.posterior(drawn.batch.images.flatten(0, 2) / 255.0)
    noise = drawn.draws.posterior_noise
    latents = (mean.view(noise.shape) + std.view(noise.shape) * noise - 0.0609) * 1.5305
    inputs, targets = noisy_inputs(drawn.batch, texts, latents, drawn.draws)
    loss, _ = tiny.loss("network", drawn, {"network": tiny.network}, CPU)
    assert loss.item() == pytest.approx(loss_of(tiny.network(inputs), targets).item(), rel=1e-6)
    torch.autograd.backward(loss)


def test_captions_are_encoded_once(files: dict[str, Any]) -> None:
    for capacity, expected in ((1000, [3, 0, 1, 0]), (0, [3, 3, 3, 3]), (2, [3, 1, 3, 3])):
        of = create(files, cached_captions=capacity)
        asked: list[int] = []
        encode = of._text.encode_all

        def counted(texts: Any, encode: Any = encode, asked: list[int] = asked) -> Any:
            asked.append(len(texts))
            return encode(texts)

        of._text.encode_all = counted  # type: ignore[method-assign, assignment]
        found = []
        for text in ("Sun", "Sun", "Fog", "Fog"):
            batch = of.draw([clip(captions=(("Rain", text, text),) * 2)], 0, 0, 0).batch
            before = sum(asked)
            found.append((of._texts(batch, CPU), sum(asked) - before))
        if capacity != 2:
            assert [count for _, count in found] == expected
        assert same(found[0][0], found[1][0]) and same(found[2][0], found[3][0])
        assert len(of._captions) <= capacity


def test_bf16_is_close(files: dict[str, Any]) -> None:
    drawn = create(files).draw([clip()], 0, 0, 0)
    expected = create(files).loss("network", drawn, {"network": create(files).network}, CPU)[0]
    for optimizer, trained in (("adamw", torch.float32), ("adamw8bit", torch.bfloat16)):
        of = create(files, TrainOptions(precision="bf16", optimizer=optimizer), train="points+lora:2")
        dtypes = {parameter.dtype for parameter in of.network.parameters() if parameter.requires_grad}
        frozen = {parameter.dtype for parameter in of.network.parameters() if not parameter.requires_grad}
        assert dtypes == {trained} and frozen == {torch.bfloat16}
        with torch.autocast("cpu", torch.bfloat16):
            loss, _ = of.loss("network", drawn, {"network": of.network}, CPU)
        torch.autograd.backward(loss)
        assert loss.dtype is torch.float32 and loss.item() != expected.item()
        assert loss.item() == pytest.approx(expected.item(), rel=0.02)
    with pytest.raises(ValueError, match="^train.ema needs weights in float32"):
        create(files, TrainOptions(precision="bf16", optimizer="adamw8bit", ema=0.99))


def test_latents_are_in_single_precision(tiny: PasTask) -> None:
    drawn = tiny.draw([clip()], 0, 0, 0)
    expected = tiny._inputs(drawn, CPU)[1].latents
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(tiny._inputs(drawn, CPU)[1].latents, expected)


@pytest.mark.parametrize("train", ["all", "points+lora:2"])
def test_weights_are_a_checkpoint(files: dict[str, Any], tmp_path: Path, train: str) -> None:
    of, only = create(files, train=train), clip()
    step(of, of.draw([only], 0, 0, 0), torch.optim.AdamW(of.players[0].groups, lr=1e-2))
    tensors, header = of.weights({"network": of.network})
    path = tmp_path / "weights.safetensors"
    safetensors.save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path, header)
    about = read_header(path)
    loaded = load(path, Config.parse(about["config"]))
    assert about["camera_numbers"] == "fx,fy,cx,cy" and about["preset"] == "nuscenes"
    inputs, _ = of._inputs(of.draw([only], 1, 0, 0), CPU)
    with torch.no_grad():
        expected = of.network(inputs)
        found = type(of.network)(loaded)(inputs)
    assert float((found - expected).abs().max()) < 1e-5 * float(expected.std())
    start = create(files).network.network.state_dict()
    assert sum(not torch.equal(tensor, start[name]) for name, tensor in tensors.items()) > 10


def test_a_process_takes_the_header(files: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes and camera numbers follow the weights, unless options say otherwise."""
    from pskel.models.pas import __main__ as command
    from pskel.models.pas import server

    of = create(files, preset="nuplan")
    tensors, header = of.weights({"network": of.network})
    stored = {name: tensor.contiguous() for name, tensor in tensors.items()}
    safetensors.save_file(stored, tmp_path / "w.safetensors", header)
    found = []

    def serve(source: Any, out: Any, models: Any, **options: Any) -> None:
        found.append((models.network.config, options["camera_numbers"]))

    monkeypatch.setattr(server, "serve", serve)
    given = {"weights": str(tmp_path / "w.safetensors"), "base": files["base"], "device": "cpu", "dtype": "f32"}
    arguments = [text for name, value in given.items() for text in (f"--{name}", value)]
    for more in ([], ["--camera-numbers", "fx,fy,cx,cy"]):
        options = command.parser().parse_args([*arguments, *more])
        assert command.run(options, None, None) == 0  # type: ignore[arg-type]
    assert found == [(of.config, "fx,0,cx,fy"), (of.config, "fx,fy,cx,cy")]


def test_validations_repeat(files: dict[str, Any]) -> None:
    of, only, modules = create(files, infer_steps=2), clip(), {}
    modules["network"] = of.network.eval()
    with torch.no_grad():
        scores, pictures = of.scores(only, modules), of.pictures(only, modules)
        assert scores.keys() == {"loss", "psnr_db"} and scores == of.scores(only, modules)
        assert torch.equal(pictures, of.pictures(only, modules)) and pictures.dtype is torch.uint8
    assert pictures.shape == (4, 3, 32, 3 * 64)
    for row, images in ((0, only.color), (1, only.boxes), (3, only.images)):
        assert torch.equal(pictures[row].view(3, 32, 3, 64).permute(2, 0, 1, 3), images[-1])
    assert pictures[2].float().std() > 0.0
    assert scores["psnr_db"] < 20.0


def test_samples_follow_the_velocity() -> None:
    """A velocity that points away from some latents leads to them; the halves of guidance have their conditions."""
    of = StepOptions()
    target = torch.randn(1, 2, 3, 16, 4, 8, generator=torch.Generator().manual_seed(1))
    noise = torch.randn(target.shape, generator=torch.Generator().manual_seed(2))
    batch = batch_of_clip()
    texts = Texts(torch.arange(3.0).view(3, 1, 1), torch.arange(3.0).view(3, 1))
    seen = []

    def exact(inputs: Any) -> Any:
        seen.append(inputs)
        return (inputs.sample - target) / (inputs.timestep[..., None, None, None] / 1000.0)

    found = sample(exact, batch, texts, noise, of, steps=5, guidance=2.0)
    assert float((found - target).abs().max()) < 1e-4 and len(seen) == 10
    levels = [float(inputs.timestep[0, 0, 0]) for inputs in seen[::2]]
    times = [1.0 + (1e-3 - 1.0) * i / 4 for i in range(5)]
    assert levels == pytest.approx([3000 * t / (1 + 2 * t) for t in times], rel=1e-5)
    kept, dropped = seen[:2]
    assert (kept.text.flatten() > 0).all() and (dropped.text == 0).all() and not kept.single_frames.any()
    assert (dropped.layout == torch.tensor(0.1255)).all() and (dropped.ids[..., -2:] == -1000.0).all()
    assert torch.equal(dropped.points, kept.points) and torch.equal(kept.ids, batch.ids)

    def of_text(inputs: Any) -> Any:
        return (inputs.text[..., :1, :1, None] > 0).float().expand(inputs.sample.shape)

    # Velocities 1 and 0: a guidance of 3 makes 3, from sigma 1 to 0.
    assert torch.allclose(sample(of_text, batch, texts, noise, of, steps=4, guidance=3.0), noise - 3.0, atol=1e-5)


def batch_of_clip() -> Any:
    from pskel.models.pas.training.collate import collate

    sizes = {"num_attention_heads": 4, "attention_head_dim": 384}
    return collate([clip()], Config.parse(sizes), "fx,fy,cx,cy")


def test_depth_has_the_channels_of_the_renderer() -> None:
    """docs/src/reference/maps.md: u = min(bin, n-1) / (n-1), sines and cosines of 2 pi u 2^(k log2(n/2) / 7)."""
    from pskel.models.pas.training.depth import depth_channels

    bins = torch.tensor([[0, 1, 100], [254, 255, 256]], dtype=torch.int16)
    found = depth_channels(bins, 256, "both")
    assert found.shape == (17, 2, 3)
    for row, column in ((0, 1), (0, 2), (1, 0), (1, 1), (1, 2)):
        u = min(int(bins[row, column]), 255) / 255
        waves = [function(2 * math.pi * u * 2**k) for function in (math.sin, math.cos) for k in range(8)]
        assert found[:, row, column].tolist() == pytest.approx([u, *waves], abs=1e-4)
    assert found[:, 0, 0].tolist() == [-1.0] + [0.0] * 16
    plain = depth_channels(bins, 256, "continuous")
    assert torch.equal(plain[0], found[0]) and (plain[1:] == 0).all()
    assert depth_channels(bins.clamp(max=128), 128, "both")[9:, 0, 2].tolist() == pytest.approx(
        [math.cos(2 * math.pi * 100 / 127 * 2 ** (k * 6 / 7)) for k in range(8)], abs=1e-4
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"base": None}, "expected base, a folder of Stable Diffusion 3.5, found none"),
        ({"speed": 1}, "expected the options base, weights, .*, found 'speed'"),
        ({"train": "half"}, "expected train of all, or adapters, points and lora:R joined by +, found 'half'"),
        ({"preset": "kitti"}, "expected preset of nuscenes, .*, found 'kitti'"),
        ({"depth": "log"}, "expected depth of continuous or both, found 'log'"),
        ({"camera_numbers": "fx"}, "expected camera_numbers of fx,fy,cx,cy, fx,0,cx,fy, found 'fx'"),
        ({"drop_text": 1.5}, "expected drop_text of 0 to 1, found 1.5"),
        ({"roll_levels": 2}, "expected roll_levels of 0 to 1, found 2.0"),
        ({"input_scale_std": -1}, "expected input_scale_std of 0 to inf, found -1.0"),
        ({"image_batch": 0}, "expected image_batch of at least 1, found 0"),
        ({"checkpointing": 1}, "expected checkpointing of type bool, found 1"),
        ({"export": "some"}, "expected export of full, trained, found 'some'"),
    ],
)
def test_bad_options_are_rejected(files: dict[str, Any], options: dict[str, Any], message: str) -> None:
    given = {name: value for name, value in {**files, **options}.items() if value is not None}
    pattern = re.escape(message).replace(r"\.\*", ".*")
    with pytest.raises(ValueError, match=f"^{pattern}$"):
        task(given, TrainOptions())


def test_clips_that_do_not_fit_are_rejected(tiny: PasTask) -> None:
    good = clip(0)
    other_names = ("A", "B", "C")
    for clips, message in (
        ([clip(frames=1)], "expected clips of at least 2 frames, for the motion of the ego, found 1: log log-0, fr"),
        ([good, clip(1, frames=3)], "expected images [2, 3, 3, 32, 64] as in the first clip of the batch, found [3, "),
        ([good, clip(1, names=other_names)], "expected cameras ['CAM_FRONT', "),
        ([good, clip(1, bins=good.bins // 4, recipe={"bins": {"count": 128}})], "expected depth bins 256 as in the"),
        ([clip(recipe={"bins": {"count": 100}})], "expected depth bins of at most 100, found 256: log log-0, frame 0"),
        ([clip(recipe={"bins": {"count": "many"}})], "expected bins.count of 2 or more in the recipe, found 'many'"),
        ([clip(images=good.images[..., :24, :])], "expected height and width in multiples of 16, found 24x64: log"),
    ):
        with pytest.raises(DataError, match=f"^{re.escape(message)}"):
            tiny.draw(clips, 0, 0, 0)
    with pytest.raises(DataError, match="^expected clips of at least 2 frames"):
        tiny.prepare(iter([clip(frames=1)]))
    tiny.prepare(iter([good]))


def test_presets_say_what_they_follow(files: dict[str, Any], capsys: Any) -> None:
    """Values of the authors' configurations, and of the paper."""
    found = {
        name: (of.learning_rate, of.clips * of.processes, of.recipe["radius_m"], of.drop_action)
        for name, of in PRESETS.items()
    }
    assert found == {
        "nuscenes": (7e-5, 16, 50.0, 0.2),
        "nuplan-layout": (6e-5, 6, 100.0, 0.0),
        "nuplan": (6e-5, 1, 100.0, 0.0),
        "paper-nuscenes": (6e-5, 16, 100.0, 0.2),
        "paper-nuplan": (6e-5, 16, 100.0, 0.2),
    }
    for name, preset in PRESETS.items():
        assert preset.recipe["bins"] == {"far_m": preset.recipe["radius_m"]}
        assert recipe({"preset": name}) is preset.recipe
        assert preset.follows.startswith("the paper" if name.startswith("paper") else "the authors' code")
        of = create(files, preset=name)
        assert of.step.drop_action == preset.drop_action and of.step.with_points == (name != "nuplan-layout")
        assert main([name]) == 0 and capsys.readouterr().out == configuration(name)
    assert create(files, preset="nuplan", drop_action=0.3).step.drop_action == 0.3
    assert main([]) == 2 and main(["kitti"]) == 2


def test_configurations_of_presets_are_read() -> None:
    tomllib = pytest.importorskip("tomllib")
    for name, preset in PRESETS.items():
        config = TrainConfig.parse(tomllib.loads(configuration(name)))
        train = config.train.learning_rate, config.train.batch
        assert (config.network, *train) == ("pas", preset.learning_rate, preset.clips)
        assert config.data.variants == (5 if name == "paper-nuplan" else 1)
        assert config.data.recipe == preset.recipe and config.data.stride == 6 and config.options["preset"] == name


def test_the_harness_gets_one_player(tiny: PasTask) -> None:
    (player,) = tiny.players
    parameters = [parameter for group in player.groups for parameter in group["params"]]
    assert player.name == "network" and player.start == 0 and player.module is tiny.network
    assert {id(parameter) for parameter in parameters} == {id(p) for p in tiny.network.parameters() if p.requires_grad}
    assert tiny.network._no_split_modules == ["JointTransformerBlock", "SelfAttentionBlock"]
