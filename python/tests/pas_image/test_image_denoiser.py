"""The image variant as a denoiser and codec, in another process and in this one."""

import argparse
import io as streams
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
transformers = pytest.importorskip("transformers")
from image_base import CAMERAS, Array, Peer, pack, unpack  # noqa: E402
from image_frames import (  # noqa: E402
    FPS,
    HELLO,
    IMAGE_SIZES,
    SHAPE,
    H,
    L,
    V,
    W,
    arguments,
    created,
    request,
    window,
    write_weights,
)
from pskel.models.pas_image import Denoiser, FrameCondition, Models, Rig  # noqa: E402
from pskel.models.pas_image import __main__ as command  # noqa: E402
from pskel.models.pas_image.config import TINY  # noqa: E402
from pskel.models.pas_image.network import Inputs  # noqa: E402

pytest_plugins = ["image_base", "image_frames"]

TABLE = {"beta_start": 0.00085, "beta_end": 0.012, "beta_schedule": "scaled_linear"}


def predict_directly(models: Models, base: Path, latents: Any, timesteps: Any, frames: list[dict[str, Any]]) -> Any:
    """The network called without the denoiser, with arguments built here."""
    tokenizer = transformers.CLIPTokenizer.from_pretrained(base / "tokenizer")
    encoder = transformers.CLIPTextModel.from_pretrained(base / "text_encoder").eval()
    ids = np.empty((1, L, V, 13))
    for number, arrays in enumerate(frames):
        forward, left, yaw = frames[max(number, 1)]["action"].astype(float).tolist()  # the first repeats the second
        distance = np.hypot(forward, left)
        speed, steering = distance * FPS * 3.6, yaw / distance * 2.7 * 14
        if forward == -1000.0:
            speed = steering = -1000.0
        for view, (width, height) in enumerate(IMAGE_SIZES):
            camera = arrays["cameras"][view].astype(float).tolist()
            fx, fy, cx, cy = camera[12:]
            pose = [camera[i] for i in (2, 6, 10, 3, 7, 11)]
            ids[0, number, view] = [FPS, fx * (width / height), fy, cx, cy, *pose, speed, steering]
    points = np.stack([frame["points"] for frame in frames])[None]
    points[:, :, :, 4:] = 0.0
    with torch.inference_mode():
        tokens = []
        for frame in frames:
            text = tokenizer(
                [frame["prompt"]], padding="max_length", max_length=77, truncation=True, return_tensors="pt"
            )
            tokens.append(encoder(text.input_ids).last_hidden_state[0])
        output = models.network(
            Inputs(
                sample=torch.tensor(latents)[None],
                timestep=torch.tensor(timesteps)[None],
                text=torch.stack(tokens)[None, :, None].expand(1, L, V, -1, -1),
                layout=torch.tensor(np.stack([frame["layout"] for frame in frames]))[None],
                points=torch.tensor(points),
                ids=torch.tensor(ids, dtype=torch.float32),
                mask=torch.tensor([[[abs(i - j) in (0, 1, V - 1) for j in range(V)] for i in range(V)]]),
                single_frames=None,
            )
        )
    return output[0].numpy()


def dropped(arrays: dict[str, Any]) -> dict[str, Any]:
    """Values of docs/src/reference/denoiser.md for the unconditional half."""
    layout, action = np.full_like(arrays["layout"], 0.1255), np.full_like(arrays["action"], -1000.0)
    return {**arrays, "layout": layout, "action": action, "prompt": ""}


@pytest.mark.parametrize("is_dropped", [False, True])
def test_predictions_equal_the_network(
    peer: Peer, models: Models, denoiser: Denoiser, base: Path, is_dropped: bool
) -> None:
    latents, timesteps, sigmas, frames = window()
    if is_dropped:
        frames = [dropped(frame) for frame in frames]
    first = peer.ask(*request(latents, timesteps, sigmas, frames, call=7))
    assert peer.ask(*request(latents, timesteps, sigmas, frames, call=7)) == first
    texts, tensors = unpack(first)
    assert texts == {"call": "7"} and list(tensors) == ["prediction"]
    np.testing.assert_array_equal(tensors["prediction"], denoiser(latents, timesteps, sigmas, created(frames)))
    expected = predict_directly(models, base, latents, timesteps, frames)
    assert expected.std() > 0.1
    # The adapters encode frame by frame in the denoiser.
    assert np.abs(tensors["prediction"] - expected).max() < 1e-5 * expected.std()


def test_one_call_gives_both_halves_of_guidance(peer: Peer, denoiser: Denoiser) -> None:
    latents, timesteps, sigmas, frames = window()
    names = ["layout", "action", "color", "depth"]
    texts, tensors = request(latents, timesteps, sigmas, frames)
    both = unpack(peer.ask({**texts, "dropped": json.dumps(names)}, tensors))[1]
    bare = [condition.without(*names) for condition in created(frames)]
    np.testing.assert_array_equal(both["prediction"], denoiser(latents, timesteps, sigmas, created(frames)))
    np.testing.assert_array_equal(both["unconditional"], denoiser(latents, timesteps, sigmas, bare))
    assert (both["prediction"] != both["unconditional"]).any()


def test_calls_do_not_depend_on_each_other(models: Models, rig: Rig) -> None:
    calls = [window(first) for first in (0, 1, 0)]
    results = []
    for capacity in (0, 1, 4):
        denoiser = Denoiser(models, rig, cached_frames=capacity)
        results.append([denoiser(*call[:3], created(call[3])) for call in calls])
    for found in results[1:]:
        for ours, expected in zip(found, results[0]):
            np.testing.assert_array_equal(ours, expected)
    np.testing.assert_array_equal(results[0][0], results[0][2])
    assert (results[0][0] != results[0][1]).any()


class Recorder:
    """Latents, levels and text tokens that the network of a denoiser gets."""

    def __init__(self, models: Models) -> None:
        self.calls: list[tuple[Any, Any]] = []
        self.texts: list[Any] = []
        self._hook = models.network.register_forward_pre_hook(self._record)

    def _record(self, _: Any, given: tuple[Any, ...]) -> None:
        self.calls.append((given[0][0].clone(), given[1][0].clone()))
        self.texts.append(given[2].text.clone())

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self._hook.remove()


def test_references_get_the_noise_of_their_level(models: Models, rig: Rig, denoiser: Denoiser, peer: Peer) -> None:
    latents, _, sigmas, frames = window()
    timesteps = np.array([1.0, 701.0], np.float32)  # the last step, as a finished frame has it
    conditions = created(frames, [True, False])
    with Recorder(models) as seen:
        first = denoiser(latents, timesteps, sigmas, conditions)
        denoiser(latents, timesteps - [0.0, 50.0], sigmas, [frame.without("layout") for frame in conditions])
        Denoiser(models, rig, seed=1)(latents, timesteps, sigmas, conditions)
        Denoiser(models, rig, history_level=200)(latents, timesteps, sigmas, conditions)
    (sample, levels), (again, _), (other, _), (noisier, more) = seen.calls
    assert levels.tolist() == [100.0, 701.0] and more.tolist() == [200.0, 701.0]
    assert all(torch.equal(x[1], torch.tensor(latents[1])) for x in (sample, again, other, noisier))
    assert torch.equal(again[0], sample[0]) and not torch.equal(other[0], sample[0])
    a = float(diffusers.DDPMScheduler(**TABLE).alphas_cumprod[100])
    noise = (sample[0] - a**0.5 * torch.tensor(latents[0])) / (1 - a) ** 0.5
    # 1080 numbers: five standard errors.
    assert abs(float(noise.mean())) < 0.16 and abs(float(noise.square().mean()) - 1) < 0.22
    a = float(diffusers.DDPMScheduler(**TABLE).alphas_cumprod[200])
    same = (noisier[0] - a**0.5 * torch.tensor(latents[0])) / (1 - a) ** 0.5
    assert (same - noise).abs().max() < 1e-4
    # The process is told which frames are references.
    found = unpack(peer.ask(*request(latents, timesteps, sigmas, frames, [True, False])))[1]["prediction"]
    np.testing.assert_array_equal(found, first)
    assert (unpack(peer.ask(*request(latents, timesteps, sigmas, frames)))[1]["prediction"] != first).any()


def test_other_frames_remain_as_they_are(models: Models, rig: Rig, denoiser: Denoiser) -> None:
    latents, _, sigmas, frames = window()
    last = np.array([1.0, 451.0], np.float32)
    noised = np.array([51.0, 451.0], np.float32)  # with --history-noise of the loop
    with Recorder(models) as seen:
        denoiser(latents, last, sigmas, created(frames))
        denoiser(latents, noised, sigmas, created(frames, [True, False]))
        Denoiser(models, rig, history_level=0)(latents, last, sigmas, created(frames, [True, False]))
        Denoiser(models, rig, is_causal=True)(latents, last, sigmas, created(frames))
        denoiser(latents, last, sigmas, created(frames, [True, False]))
    assert all(torch.equal(sample, torch.tensor(latents)) for sample, _ in seen.calls[:3])
    assert [levels.tolist() for _, levels in seen.calls[:3]] == [[1.0, 451.0], [51.0, 451.0], [0.0, 451.0]]
    # With the strategy causal, all frames but the last are references.
    for ours, expected in zip(seen.calls[3], seen.calls[4]):
        assert torch.equal(ours, expected)


def test_levels_of_a_table_without_signal(base: Path, tmp_path: Path, rig: Rig) -> None:
    config = replace(TINY, prediction="velocity", zero_snr=True)
    path = write_weights(tmp_path / "w.safetensors", base, config)
    models = Models.load(path, base, dtype=torch.float32, device="cpu")
    latents, timesteps, sigmas, frames = window()
    with Recorder(models) as seen:
        Denoiser(models, rig)(latents, timesteps, sigmas, created(frames))
    tables = [
        diffusers.DDPMScheduler(**TABLE, rescale_betas_zero_snr=zero).alphas_cumprod.double().numpy()
        for zero in (False, True)
    ]
    expected = [np.sqrt(tables[0][151]), np.sqrt(tables[0][701])]
    found = np.interp(seen.calls[0][1].numpy(), np.arange(1000), np.sqrt(tables[1]))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_images_equal_the_autoencoder(peer: Peer, denoiser: Denoiser, base: Path) -> None:
    vae = diffusers.AutoencoderKL.from_pretrained(base / "vae")
    images = np.random.default_rng(1).random((V, 3, H, W), np.float32)
    with torch.inference_mode():
        expected = (vae.encode(torch.from_numpy(images) * 2 - 1).latent_dist.mode() * 0.18215).contiguous().numpy()
        decoded = vae.decode(torch.from_numpy(expected) / 0.18215).sample
        expected_images = (decoded / 2 + 0.5).clamp(0, 1).numpy()
    latents = unpack(peer.ask({"ask": "encode"}, {"images": images}))[1]["latents"]
    assert latents.shape == SHAPE
    np.testing.assert_array_equal(latents, expected)
    np.testing.assert_array_equal(denoiser.encode(images), expected)
    found = unpack(peer.ask({"ask": "decode"}, {"latents": expected}))[1]["images"]
    np.testing.assert_array_equal(found, expected_images)
    np.testing.assert_array_equal(denoiser.decode(expected), expected_images)
    assert expected.std() > 0.01 and expected_images.std() > 0.0


def test_cameras_in_another_order_give_the_same(models: Models, rig: Rig, denoiser: Denoiser) -> None:
    latents, timesteps, sigmas, frames = window()
    shuffle = [3, 0, 5, 1, 4, 2]
    shuffled = Rig(tuple(CAMERAS[i] for i in shuffle), tuple(rig.image_sizes[i] for i in shuffle), FPS)
    names = ("points", "layout", "cameras")
    moved = [{**frame, **{name: frame[name][shuffle] for name in names}} for frame in frames]
    found = Denoiser(models, shuffled)(latents[:, shuffle], timesteps, sigmas, created(moved))
    expected = denoiser(latents, timesteps, sigmas, created(frames))
    assert np.abs(found - expected[:, shuffle]).max() < 1e-4 * expected.std()
    unknown = Rig(tuple(f"camera {i}" for i in range(V)), shuffled.image_sizes, FPS)  # a ring in this order
    other = Denoiser(models, unknown)(latents[:, shuffle], timesteps, sigmas, created(moved))
    assert np.abs(other - found).max() > 1e-2 * expected.std()


def test_prompts_are_encoded_once(models: Models, rig: Rig) -> None:
    counts = [0, 0]

    def counted(number: int) -> Any:
        def hook(*_: Any) -> None:
            counts[number] += 1

        return hook

    models.text._tokens = type(models.text._tokens)(64)
    hooks = [
        models.text.encoder.register_forward_hook(counted(0)),
        models.network.layout_adapter.register_forward_hook(counted(1)),
    ]
    denoiser = Denoiser(models, rig)
    try:
        for first, expected in ((0, [2, 2]), (0, [2, 2]), (1, [2, 3]), (0, [2, 3])):
            latents, timesteps, sigmas, frames = window(first)
            denoiser(latents, timesteps, sigmas, created(frames))
            assert counts == expected
    finally:
        for each in hooks:
            each.remove()


def test_each_camera_may_have_a_prompt(peer: Peer, denoiser: Denoiser, models: Models) -> None:
    latents, timesteps, sigmas, frames = window()
    texts = [f"camera {view}" for view in range(V)]
    same = [{**frame, "prompt": "camera 2"} for frame in frames]
    each = [{**frames[0], "prompt": texts}, {**frames[1], "prompt": "camera 2"}]
    with Recorder(models) as seen:
        found = denoiser(latents, timesteps, sigmas, created(each))
        assert (denoiser(latents, timesteps, sigmas, created(same)) != found).any()
    np.testing.assert_array_equal(unpack(peer.ask(*request(latents, timesteps, sigmas, each)))[1]["prediction"], found)
    first, second = seen.texts[0][0], seen.texts[1][0]
    assert torch.equal(first[1], second[1]) and torch.equal(first[0, 2], second[0, 2])
    assert all(torch.equal(first[0, view], models.text(text)) for view, text in enumerate(texts))
    with pytest.raises(ValueError, match="^expected a prompt, or one for each of 6 cameras, found 2$"):
        FrameCondition.create(**{**frames[0], "prompt": texts[:2]})


def test_invalid_calls_are_refused(denoiser: Denoiser, models: Models, rig: Rig) -> None:
    latents, timesteps, sigmas, frames = window()
    conditions = created(frames)
    for call, message in [
        ((latents[:, :5], timesteps, sigmas, conditions), "expected latents of [2, 6, 4, 5, 9], found [2, 5, 4, 5, 9]"),
        ((latents, timesteps[:1], sigmas, conditions), "expected timesteps of [2], found [1]"),
        ((latents, timesteps + 0.5, sigmas, conditions), "expected whole timesteps of 0 to 999, found 151.5"),
        ((latents, timesteps * np.inf, sigmas, conditions), "expected whole timesteps of 0 to 999, found inf"),
        (
            (latents[:1], timesteps[:1], sigmas[:1], conditions[:1]),
            "expected at least 2 frames for the motion of the ego, found 1",
        ),
        ((latents, timesteps, sigmas, []), "expected at least 2 frames for the motion of the ego, found 0"),
    ]:
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            denoiser(*call)
    infinite = np.full_like(latents, np.inf)
    with pytest.raises(ValueError, match="expected a finite prediction, found infinite or undefined values"):
        denoiser(infinite, timesteps, sigmas, conditions)
    with pytest.raises(ValueError, match="expected a history level of 0 to 999, found 1000"):
        Denoiser(models, rig, history_level=1000)


def failure(capsys: pytest.CaptureFixture[str], arguments: list[str], *sent: bytes) -> str:
    """Error of the command, which fails after the messages ``sent``."""
    capsys.readouterr()
    options: argparse.Namespace = command.parser().parse_args(arguments)
    assert command.run(options, streams.BytesIO(b"".join(sent)), streams.BytesIO()) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = [line for line in printed.err.splitlines() if "were trained with" not in line]
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("pskel.models.pas_image: ")
    return lines[0].removeprefix("pskel.models.pas_image: ")


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        (
            {"sampler": "flow_match", "prediction": "velocity"},
            "expected --sampler ddim_epsilon, found flow_match with prediction velocity",
        ),
        ({"prediction": "velocity"}, "expected --sampler ddim_epsilon, found ddim with prediction velocity"),
        ({"window": "1"}, "expected a window of at least 2 frames, found 1"),
        ({"condition_size": "40,76"}, "expected height and width in multiples of 8, found 40x76"),
    ],
)
def test_other_hellos_are_refused(
    capsys: pytest.CaptureFixture[str], base: Path, weights: Path, changed: dict[str, str], expected: str
) -> None:
    assert failure(capsys, arguments(base, weights), pack({**HELLO, **changed}, {})) == expected


def test_other_requests_are_refused(capsys: pytest.CaptureFixture[str], base: Path, weights: Path) -> None:
    hello = pack(HELLO, {})
    texts, tensors = request(*window())

    def refused(texts: dict[str, str], tensors: dict[str, Array]) -> str:
        return failure(capsys, arguments(base, weights), hello, pack(texts, tensors))

    for references in ("[true]", "[1, 0]"):
        found = refused({**texts, "references": references}, tensors)
        assert found == f"expected references as a list of 2 booleans in the call, found {references}"
    without = {name: tensor for name, tensor in tensors.items() if name != "action"}
    assert refused(texts, without) == "expected the tensor action of [2, 3], found none"
    image = {"images": np.zeros((V, 3, W, H), np.float32)}
    assert refused({"ask": "encode"}, image) == "expected the tensor images of [6, 3, 40, 72], found [6, 3, 72, 40]"


def test_other_files_are_refused(capsys: pytest.CaptureFixture[str], base: Path, weights: Path, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing"
    found = failure(capsys, arguments(nothing, weights))
    assert found == f"expected a folder of Stable Diffusion 1.5, found none: {nothing}"
    copy = tmp_path / "base"
    shutil.copytree(base, copy)
    shutil.rmtree(copy / "unet")  # not read, as all weights were trained
    assert failure(capsys, arguments(copy, weights), pack({**HELLO, "views": "5"}, {})).startswith("expected cameras")
    diffusers.AutoencoderKL(block_out_channels=(32,), latent_channels=4).save_pretrained(copy / "vae")
    found = failure(capsys, arguments(copy, weights))
    assert found == f"expected latents of 4 channels at 1/8 of the size of images, found 4 at 1/1: {copy / 'vae'}"
    shutil.rmtree(copy / "vae")
    shutil.copytree(base / "vae", copy / "vae")
    config = json.loads((copy / "text_encoder" / "config.json").read_text())
    text = transformers.CLIPTextConfig(**{**config, "hidden_size": 20})
    transformers.CLIPTextModel(text).save_pretrained(copy / "text_encoder")
    found = failure(capsys, arguments(copy, weights))
    assert found == f"expected a text encoder of 24 channels, found 20: {copy / 'text_encoder'}"
    (copy / "text_encoder" / "model.safetensors").write_bytes(b"damaged")
    found = failure(capsys, arguments(copy, weights))
    assert found.startswith("expected a CLIPTextModel, found ") and found.endswith(f": {copy / 'text_encoder'}")
    assert failure(capsys, arguments(base, tmp_path / "none.safetensors")) == (
        f"[Errno 2] No such file or directory: '{tmp_path / 'none.safetensors'}'"
    )
    found = failure(capsys, arguments(base, weights, history_level="1000"), pack(HELLO, {}))
    assert found == "expected a history level of 0 to 999, found 1000"
    found = failure(capsys, arguments(base, weights, device="tpu"))
    assert found == "expected --device cuda, cuda:N or cpu, found tpu"


def test_conditions_are_those_of_the_video_network() -> None:
    from pskel.models import pas

    assert pas.FrameCondition is FrameCondition and pas.Rig is Rig
