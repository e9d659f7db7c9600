"""The video network of *Point as Skeleton* as a denoiser and codec of the loop, in another process and in this one."""

import argparse
import io as streams
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from pas_base import Array, Peer, pack, unpack, write_base

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
transformers = pytest.importorskip("transformers")
from pskel.models.pas import Config, Denoiser, FrameCondition, Models, Rig, added_time_ids  # noqa: E402
from pskel.models.pas import __main__ as command  # noqa: E402
from pskel.models.pas import messages  # noqa: E402
from pskel.models.pas.cache import Cache  # noqa: E402
from pskel.models.pas.ids import ids_from_motion  # noqa: E402
from pskel.models.pas.rig import PUBLISHED, inverse, ring_mask  # noqa: E402

SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[3] / "shared"))
FIXTURE = Path(os.environ.get("PSKEL_FIXTURES", SHARED / "fixtures")) / "pas-network"
pytestmark = pytest.mark.skipif(not FIXTURE.exists(), reason="pas-network is not there (set PSKEL_SHARED)")

CAMERAS = ["CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT"]
TRAINED = [5, 0, 1, 2, 3, 4]  # FL F FR BR B BL
IMAGE_SIZES = [[1600, 900]] * 5 + [[800, 600]]
L, V, H, W = 3, 6, 32, 64
SHAPE = (V, 16, H // 8, W // 8)
STEPS = 3
FPS = 6.0
Network = Callable[[Array, Array, Array, list[FrameCondition]], Array]

HELLO = {
    "protocol": "pskel-denoiser",
    "version": "1",
    "window": str(L),
    "views": str(V),
    "condition_size": f"{H},{W}",
    "sampler": "flow_match",
    "prediction": "velocity",
    "fps": "6.0",
    "cameras": json.dumps(CAMERAS),
    "image_sizes": json.dumps(IMAGE_SIZES),
}


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_base(tmp_path_factory.mktemp("base"))


@pytest.fixture(scope="module")
def models(base: Path) -> Models:
    config = Config.read(FIXTURE / "config.json")
    return Models.load(FIXTURE / "weights.safetensors", base, config, dtype=torch.float32, device="cpu")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(tuple(CAMERAS), tuple((width, height) for width, height in IMAGE_SIZES), FPS)


@pytest.fixture
def denoiser(models: Models, rig: Rig) -> Denoiser:
    return Denoiser(models, rig)


def arguments(base: Path, **changed: str) -> list[str]:
    weights, config = str(FIXTURE / "weights.safetensors"), str(FIXTURE / "config.json")
    options = {"weights": weights, "base": str(base), "config": config, "device": "cpu", "dtype": "f32", **changed}
    return [text for name, value in options.items() for text in (f"--{name}", value)]


@pytest.fixture(scope="module")
def peer(base: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Peer]:
    peer = Peer(arguments(base), tmp_path_factory.mktemp("peer") / "errors.txt")
    texts, tensors = unpack(peer.ask(HELLO, {}))
    assert texts == {
        "protocol": "pskel-denoiser",
        "version": "1",
        "latent_shape": "6,16,4,8",
        "dtype": "F32",
        "image_size": "32,64",
    }
    assert not tensors
    yield peer
    assert peer.close() == 0
    # Nothing but the notice about inputs that differ from those of the training.
    assert peer.errors.read_text() == (
        "pskel.models.pas: the published nuScenes checkpoint was trained with 12 frames of 256x448 at 6 per second, "
        "found 3 frames of 32x64 at 6 per second\n"
    )


def condition_arrays(index: int) -> dict[str, Any]:
    """Arrays of frame ``index`` as in the protocol, in the order of CAMERAS."""
    random = np.random.default_rng(index)
    points = random.random((V, 20, H, W), np.float32)
    points[:, 3][random.random((V, H, W)) < 0.5] = -1.0
    pose = np.eye(4)[None, :3].repeat(V, 0) + random.normal(0.0, 0.3, (V, 3, 4))
    fractions = random.uniform(0.4, 0.8, (V, 4))
    return {
        "points": points,
        "layout": random.random((V, 6, H, W), np.float32),
        "action": np.array([0.8 + 0.1 * index, 0.02, 0.01 * index], np.float32),
        "cameras": np.concatenate([pose.reshape(V, 12), fractions], axis=1).astype(np.float32),
        "prompt": "Sunny. A driving scene in Boston" if index % 2 else "Rain",
    }


def condition(index: int) -> FrameCondition:
    return FrameCondition.create(**condition_arrays(index))


def window(first: int = 0) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
    """Latents, timesteps, sigmas and conditions of a window."""
    sigmas = np.array([0.1, 0.5, 0.9], np.float32)
    latents = np.random.default_rng(100 + first).normal(size=(L, *SHAPE)).astype(np.float32)
    return latents, sigmas * 1000, sigmas, [condition_arrays(first + i) for i in range(L)]


def dropped(arrays: dict[str, Any]) -> dict[str, Any]:
    """Values of docs/DENOISER.md for the unconditional half."""
    layout, action = np.full_like(arrays["layout"], 0.1255), np.full_like(arrays["action"], -1000.0)
    return {**arrays, "layout": layout, "action": action, "prompt": ""}


def request(
    latents: Array, timesteps: Array, sigmas: Array, frames: list[dict[str, Any]], call: int = 0
) -> tuple[dict[str, str], dict[str, Array]]:
    """The message of a call."""
    names = ("points", "layout", "action", "cameras")
    texts = {"ask": "predict", "call": str(call), "prompts": json.dumps([frame["prompt"] for frame in frames])}
    maps = {name: np.stack([frame[name] for frame in frames]) for name in names}
    return texts, {"latents": latents, "timesteps": timesteps, "sigmas": sigmas, **maps}


def hand_built_ids(frames: list[dict[str, Any]]) -> Any:
    """The 13 numbers ``[1, L, V, 13]`` of frames, in the order of the training."""
    ids = np.empty((1, L, V, 13))
    for frame, arrays in enumerate(frames):
        forward, left, yaw = frames[max(frame, 1)]["action"].astype(float).tolist()  # the first repeats the second
        distance = np.hypot(forward, left)
        speed, steering = distance * FPS * 3.6, yaw / distance * 2.7 * 14
        if forward == -1000.0:
            speed = steering = -1000.0
        for view, camera in enumerate(TRAINED):
            width, height = IMAGE_SIZES[camera]
            numbers = arrays["cameras"][camera].astype(float).tolist()
            fx, fy, cx, cy = numbers[12:]
            pose = [numbers[i] for i in (2, 6, 10, 3, 7, 11)]
            ids[0, frame, view] = [FPS, fx * (width / height), fy, cx, cy, *pose, speed, steering]
    return torch.tensor(ids, dtype=torch.float32)


def encode_prompts(base: Path, prompts: list[str]) -> tuple[Any, Any]:
    """Tokens and pooled tokens of the pipeline of diffusers."""
    kinds = transformers.CLIPTextModelWithProjection, transformers.CLIPTokenizer
    parts: dict[str, Any] = {"transformer": None, "scheduler": None, "vae": None}
    for suffix, (encoder, tokenizer) in {
        "": kinds,
        "_2": kinds,
        "_3": (transformers.T5EncoderModel, transformers.T5TokenizerFast),
    }.items():
        parts[f"text_encoder{suffix}"] = encoder.from_pretrained(base / f"text_encoder{suffix}")
        parts[f"tokenizer{suffix}"] = tokenizer.from_pretrained(base / f"tokenizer{suffix}")
    pipeline = diffusers.StableDiffusion3Pipeline(**parts)
    with torch.inference_mode():
        outputs = [
            pipeline.encode_prompt(prompt, None, None, do_classifier_free_guidance=False, max_sequence_length=77)
            for prompt in prompts
        ]
    return torch.cat([tokens for tokens, *_ in outputs]), torch.cat([pooled for _, _, pooled, _ in outputs])


def predict_directly(models: Models, base: Path, latents: Array, timesteps: Array, frames: list[dict[str, Any]]) -> Array:
    """The network called without the denoiser, with arguments built here."""
    tokens, pooled = encode_prompts(base, [frame["prompt"] for frame in frames])
    points = np.stack([frame["points"][TRAINED] for frame in frames])[None]
    points[:, :, :, 4:] = 0.0
    layout = np.stack([frame["layout"][TRAINED] for frame in frames])[None]
    mask = torch.tensor([[[abs(i - j) in (0, 1, V - 1) for j in range(V)] for i in range(V)]])
    with torch.inference_mode():
        conditions = models.network.encode_conditions(
            tokens[None, :, None].expand(1, L, V, -1, -1),
            pooled[None, :, None].expand(1, L, V, -1),
            torch.from_numpy(layout),
            torch.from_numpy(points),
            hand_built_ids(frames),
        )
        timestep = torch.tensor(timesteps)[None, :, None].expand(1, L, V)
        output = models.network(torch.from_numpy(latents[None, :, TRAINED]), timestep, conditions, mask)
    velocity = np.empty_like(latents)
    velocity[:, TRAINED] = output[0].numpy()
    return velocity


@pytest.mark.parametrize("is_dropped", [False, True])
def test_predictions_equal_the_network(peer: Peer, models: Models, base: Path, is_dropped: bool) -> None:
    latents, timesteps, sigmas, frames = window()
    if is_dropped:
        frames = [dropped(frame) for frame in frames]
    first = peer.ask(*request(latents, timesteps, sigmas, frames, call=7))
    assert peer.ask(*request(latents, timesteps, sigmas, frames, call=7)) == first
    texts, tensors = unpack(first)
    assert texts == {"call": "7"} and list(tensors) == ["prediction"]
    expected = predict_directly(models, base, latents, timesteps, frames)
    assert expected.std() > 0.1
    np.testing.assert_array_equal(tensors["prediction"], expected)


def test_calls_do_not_depend_on_each_other(peer: Peer, models: Models, rig: Rig) -> None:
    """Windows in turn, with caches of any size, in this process and in the other."""
    calls = [window(first) for first in (0, 1, 2, 0)]
    calls += [(*call[:3], [dropped(frame) for frame in call[3]]) for call in calls[:2]]
    found = [unpack(peer.ask(*request(*call)))[1]["prediction"] for call in calls]
    np.testing.assert_array_equal(found[0], found[3])
    assert (found[0] != found[4]).any() and (found[0] != found[1]).any()
    for capacity in (0, 1, 24):
        denoiser = Denoiser(models, rig, cached_frames=capacity)
        for (latents, timesteps, sigmas, frames), expected in zip(calls, found):
            velocity = denoiser(latents, timesteps, sigmas, [FrameCondition.create(**frame) for frame in frames])
            np.testing.assert_array_equal(velocity, expected)


def test_images_equal_the_autoencoder(peer: Peer, denoiser: Denoiser, base: Path) -> None:
    vae = diffusers.AutoencoderKL.from_pretrained(base / "vae")
    images = np.random.default_rng(1).random((V, 3, H, W), np.float32)
    with torch.inference_mode():
        mode = vae.encode(torch.from_numpy(images) * 2 - 1).latent_dist.mode()
        expected = ((mode - 0.0609) * 1.5305).contiguous().numpy()
        decoded = vae.decode(torch.from_numpy(expected) / 1.5305 + 0.0609).sample
        expected_images = (decoded / 2 + 0.5).clamp(0, 1).numpy()
    texts, tensors = unpack(peer.ask({"ask": "encode"}, {"images": images}))
    assert not texts and list(tensors) == ["latents"] and tensors["latents"].shape == SHAPE
    np.testing.assert_array_equal(tensors["latents"], expected)
    np.testing.assert_array_equal(denoiser.encode(images), expected)
    texts, tensors = unpack(peer.ask({"ask": "decode"}, {"latents": expected}))
    assert not texts and list(tensors) == ["images"]
    np.testing.assert_array_equal(tensors["images"], expected_images)
    np.testing.assert_array_equal(denoiser.decode(expected), expected_images)
    assert expected.std() > 0.01 and 0.0 < expected_images.std()


def test_half_precision(base: Path, denoiser: Denoiser, rig: Rig) -> None:
    config = Config.read(FIXTURE / "config.json")
    models = Models.load(FIXTURE / "weights.safetensors", base, config, dtype=torch.bfloat16, device="cpu")
    frames = [condition(i) for i in range(L)]
    found, expected = Denoiser(models, rig)(*window()[:3], frames), denoiser(*window()[:3], frames)
    assert found.dtype == np.float32
    error = np.sqrt(np.mean((found - expected) ** 2)) / expected.std()
    assert 0.0 < error < 0.02, error


def test_cameras_in_another_order_give_the_same(models: Models, rig: Rig, denoiser: Denoiser) -> None:
    latents, timesteps, sigmas, frames = window()
    shuffle = [3, 0, 5, 1, 4, 2]
    shuffled = Rig(tuple(CAMERAS[i] for i in shuffle), tuple(rig.image_sizes[i] for i in shuffle), FPS)
    names = ("points", "layout", "cameras")
    moved = [FrameCondition.create(**{**frame, **{name: frame[name][shuffle] for name in names}}) for frame in frames]
    found = Denoiser(models, shuffled)(latents[:, shuffle], timesteps, sigmas, moved)
    expected = denoiser(latents, timesteps, sigmas, [FrameCondition.create(**frame) for frame in frames])
    np.testing.assert_array_equal(found, expected[:, shuffle])
    unknown = Rig(tuple(f"camera {i}" for i in range(V)), rig.image_sizes, FPS)
    assert unknown.order == list(range(V)) and unknown.published is None
    other = Denoiser(models, unknown)(latents, timesteps, sigmas, [FrameCondition.create(**frame) for frame in frames])
    assert (other != expected).any()


def test_orders_and_masks_of_rigs(rig: Rig) -> None:
    assert rig.order == TRAINED and inverse(TRAINED) == [1, 2, 3, 4, 5, 0]
    nuplan = ("CAM_F0", "CAM_R0", "CAM_R1", "CAM_R2", "CAM_B0", "CAM_L2", "CAM_L1", "CAM_L0")
    order = Rig(nuplan, ((1920, 1080),) * 8, 5.0).order
    assert [nuplan[i][4:] for i in order] == ["L1", "L0", "F0", "R0", "R1", "R2", "B0", "L2"]
    for known in PUBLISHED:
        ring = [CAMERAS, list(nuplan)][known.name == "nuPlan"]
        neighbors = {(ring[i], ring[(i + step) % len(ring)]) for i in range(len(ring)) for step in (-1, 0, 1)}
        mask = Rig(known.cameras, ((64, 32),) * len(ring), known.fps).mask
        seen = {(known.cameras[i], known.cameras[j]) for i, j in mask.nonzero().tolist()}
        assert seen == neighbors
    for views in (1, 2, 3):
        assert ring_mask(views).all()


def test_numbers_equal_those_of_poses() -> None:
    """The numbers of fractions and motions are those of pixels and poses."""
    frames = [condition_arrays(i) for i in range(L)]
    cameras = torch.tensor(np.stack([frame["cameras"] for frame in frames]))
    action = torch.tensor(np.stack([frame["action"] for frame in frames]))
    sizes = torch.tensor(IMAGE_SIZES)
    poses = [torch.eye(4, dtype=torch.float64)]
    for forward, left, yaw in action.double().tolist()[1:]:
        motion = torch.eye(4, dtype=torch.float64)
        motion[:2, :2] = torch.tensor([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        motion[:2, 3] = torch.tensor([forward, left])
        poses.append(poses[-1] @ motion)
    ego_from_camera = torch.eye(4).repeat(1, L, V, 1, 1)
    ego_from_camera[0, ..., :3, :] = cameras[..., :12].view(L, V, 3, 4)
    k = torch.zeros(1, L, V, 3, 3, dtype=torch.float64)
    k[..., 0, 0], k[..., 0, 2] = cameras[..., 12] * sizes[:, 0], cameras[..., 14] * sizes[:, 0]
    k[..., 1, 1], k[..., 1, 2] = cameras[..., 13] * sizes[:, 1], cameras[..., 15] * sizes[:, 1]
    expected = added_time_ids(k, sizes.expand(1, L, V, 2), ego_from_camera, torch.stack(poses)[None, :, None], FPS)
    found = ids_from_motion(cameras, sizes, action, FPS)
    assert (found - expected[0]).abs().max() < 1e-5
    still = ids_from_motion(cameras, sizes, torch.tensor([[0.0] * 3, [0.001, 0.0, 0.1], [-1000.0] * 3]), FPS)
    assert torch.allclose(still[1, :, -2:], torch.tensor([0.001 * FPS * 3.6, -1000.0]))
    assert (still[2, :, -2:] == -1000.0).all() and torch.equal(still[0, :, -2:], still[1, :, -2:])


def test_conditions_of_frames_are_encoded_once(models: Models, denoiser: Denoiser) -> None:
    counts = dict.fromkeys(("layout", "points", "text 1", "text 2", "text 3", "blocks"), 0)

    def count(module: Any, name: str) -> Any:
        def hook(*_: Any) -> None:
            counts[name] += 1

        return module.register_forward_hook(hook)

    network = models.network
    modules = [
        network.condition_image_adapter,
        network.condition_pc_adapter,
        *models.text.encoders,
        network.transformer_blocks[0],
    ]
    hooks = [count(module, name) for module, name in zip(modules, counts)]

    def call(first: int, *, guided: bool = False) -> list[int]:
        """New runs of the modules in a call with frames ``first`` and on, of new objects with the same content."""
        before = list(counts.values())
        frames = [condition(first + i) for i in range(L)]
        frames = [frame.without("layout", "action") for frame in frames] if guided else frames
        denoiser(*window(first)[:3], frames)
        return [now - then for now, then in zip(counts.values(), before)]

    try:
        assert call(0) == [3, 3, 2, 2, 2, 1]
        assert call(0) == [0, 0, 0, 0, 0, 1]
        # The unconditional half has one layout for all frames, one prompt, and the same points.
        assert call(0, guided=True) == [1, 0, 1, 1, 1, 1]
        assert call(0, guided=True) == [0, 0, 0, 0, 0, 1]
        assert call(1) == [1, 1, 0, 0, 0, 1]
        assert call(2) == [1, 1, 0, 0, 0, 1]
        assert call(0) == [0, 0, 0, 0, 0, 1]
    finally:
        for hook in hooks:
            hook.remove()


def test_caches_are_bounded() -> None:
    cache: Cache[int] = Cache(2)
    computed: list[str] = []

    def get(key: str) -> int:
        def compute() -> int:
            computed.append(key)
            return ord(key)

        return cache.get(key, compute)

    assert [get(key) for key in "abacab"] == [97, 98, 97, 99, 97, 98]
    assert computed == ["a", "b", "c", "b"] and len(cache) == 2
    nothing: Cache[int] = Cache(0)
    assert [nothing.get("a", lambda: 1) for _ in range(2)] == [1, 1] and len(nothing) == 0
    with pytest.raises(ValueError, match="expected a cache of 0 or more values, found -1"):
        Cache(-1)


def test_dropped_parts_have_the_values_of_the_protocol() -> None:
    arrays = condition_arrays(0)
    whole = FrameCondition.create(**arrays)
    bare, expected = whole.without("layout", "action"), FrameCondition.create(**dropped(arrays))
    for name in ("points", "layout"):
        assert getattr(bare, name).key == getattr(expected, name).key
    np.testing.assert_array_equal(bare.action, expected.action)
    np.testing.assert_array_equal(bare.cameras, expected.cameras)
    assert bare.prompt == "" and bare.points is whole.points
    color, depth = whole.without("color").points.array, whole.without("depth").points.array
    assert (color[:, :3] == np.float32(0.1255)).all() and (depth[:, 3] == -1.0).all()
    np.testing.assert_array_equal(color[:, 3], arrays["points"][:, 3])
    np.testing.assert_array_equal(depth[:, :3], arrays["points"][:, :3])
    with pytest.raises(ValueError, match="expected parts of layout, action, color, depth, found boxes"):
        whole.without("boxes")
    arrays["points"][:] = 0.5  # a condition is a copy
    assert whole.points.key == condition(0).points.key


def table() -> tuple[Array, Array]:
    """Sigmas and timesteps of the scheduler of Stable Diffusion 3.5."""
    scheduler = diffusers.FlowMatchEulerDiscreteScheduler(shift=3.0)
    scheduler.set_timesteps(STEPS)
    return scheduler.sigmas.numpy(), scheduler.timesteps.numpy()


def roll_out(
    network: Network, references: list[Array], conditions: list[FrameCondition], noise: list[list[Array]], guidance: float
) -> list[Array]:
    """Reset-and-Roll, step by step: L - 1 references, then a frame per list of noise (one for each roll)."""
    sigmas, timesteps = table()
    per_roll = STEPS // L
    cache, finished_references = list(references), L - 1
    frames = []
    for step, draws in enumerate(noise):
        current = L - 1 + step
        latents, known, is_full = cache, finished_references, len(cache) == L
        for roll, fresh in enumerate(draws):
            if is_full or roll:
                latents, known = latents[1:], max(known - 1, 0)
            latents = [*latents, fresh]
            shown = conditions[current + roll - L + 1 : current + roll + 1]
            for call in range(STEPS - per_roll, STEPS):
                own = [call - j * per_roll for j in range(L)]
                index = [STEPS - 1 if j < known else min(max(own[j], 0), STEPS - 1) for j in range(L)]
                arguments = np.stack(latents), timesteps[index], sigmas[index]
                velocity = network(*arguments, shown)
                if guidance != 1.0:
                    without = network(*arguments, [frame.without("layout", "action") for frame in shown])
                    velocity = without + np.float32(guidance) * (velocity - without)
                latents = [
                    x + (sigmas[i + 1] - sigmas[i]) * v if j >= known and own[j] >= 0 else x
                    for j, (x, i, v) in enumerate(zip(latents, index, velocity))
                ]
            if roll == 0:  # it has seen no forecast
                cache, finished_references = latents, known
        frames.append(latents[0])
    return frames


def run_loop(network: Network, references: list[Array], count: int, guidance: float) -> list[Array]:
    """The same by ``pskel.ResetAndRoll``, along a log whose states carry the number of their frame."""
    simulation = pskel.Simulation(pskel.Log("town:seed=7,frames=20,size=113x200"), ego="replay", steps=36)
    loop = pskel.ResetAndRoll(network, SHAPE, window=L, steps=STEPS, guidance=guidance, seed=3)
    frames: list[Array] = []
    for number, _ in enumerate(simulation):
        now = simulation.committed.map(lambda _: condition(number))
        if number < loop.references:
            loop.add_reference(references[number], now)
            continue
        forecasts = simulation.forecast(loop.forecasts)
        ahead = [forecast.map(lambda _: condition(number + 1 + i)) for i, forecast in enumerate(forecasts)]
        frames.append(loop.step(now, ahead))
        if len(frames) == count:
            break
    return frames


def through(peer: Peer) -> Network:
    """The denoiser process as a function."""

    def network(latents: Array, timesteps: Array, sigmas: Array, conditions: list[FrameCondition]) -> Array:
        waves = np.full((V, 16, H, W), 0.5, np.float32)  # the network does not use them
        frames = [
            {
                "points": np.concatenate([frame.points.array, waves], axis=1),
                "layout": frame.layout.array,
                "action": frame.action,
                "cameras": frame.cameras,
                "prompt": frame.prompt,
            }
            for frame in conditions
        ]
        return unpack(peer.ask(*request(latents, timesteps, sigmas, frames)))[1]["prediction"]

    return network


@pytest.mark.parametrize("guidance", [1.0, 2.0])
def test_rollouts_are_the_same(peer: Peer, denoiser: Denoiser, guidance: float) -> None:
    """By the rules of the loop in this file, through the process and in this one, and by the loop of the package."""
    count = 3
    images = np.random.default_rng(9).random((L - 1, V, 3, H, W), np.float32)
    references = [denoiser.encode(image) for image in images]
    # A network without velocity shows the noise of the loop: one call per roll, the new frame last.
    seen: list[tuple[Array, Array, Array]] = []

    def still(latents: Array, timesteps: Array, sigmas: Array, _: list[FrameCondition]) -> Array:
        seen.append((latents[-1].copy(), timesteps, sigmas))
        return np.zeros_like(latents)

    run_loop(still, references, count, 1.0)
    assert len(seen) == count * L
    noise = [[draw for draw, _, _ in seen[step * L : (step + 1) * L]] for step in range(count)]

    rolled = roll_out(denoiser, references, [condition(i) for i in range(count + 2 * L)], noise, guidance)
    other = roll_out(through(peer), references, [condition(i) for i in range(count + 2 * L)], noise, guidance)
    looped = run_loop(denoiser, references, count, guidance)
    assert len(rolled) == len(other) == len(looped) == count
    for ours, theirs, packaged in zip(rolled, other, looped):
        assert np.isfinite(ours).all()
        np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(ours, packaged)
    assert (rolled[0] != rolled[1]).any()


def test_conditions_of_scenes() -> None:
    simulation = pskel.Simulation(pskel.Log("town:seed=7,frames=6,size=113x200"), ego="replay", steps=8)
    before, now = [simulation.scene for _ in simulation][:2]
    maps = {"points": np.zeros((V, 20, H, W), np.float32), "layout": np.zeros((V, 6, H, W), np.float32)}
    found = FrameCondition.from_scene(now, maps, previous=before.ego, prompt="Fog")
    motion = np.linalg.inv(before.ego) @ now.ego
    assert found.action[0] > 0.1
    np.testing.assert_allclose(found.action, [*motion[:2, 3], np.arcsin(motion[1, 0])], atol=1e-6)
    assert found.prompt == "Fog" and now.cameras == CAMERAS
    height, width = np.array(now.sizes, np.float64).T
    np.testing.assert_allclose(found.cameras[:, 12], now.intrinsics[:, 0, 0] / width, rtol=1e-6)
    np.testing.assert_allclose(found.cameras[:, 15], now.intrinsics[:, 1, 2] / height, rtol=1e-6)
    front = found.cameras[0, :12].reshape(3, 4)
    np.testing.assert_allclose(front[:, 2], [1.0, 0.0, 0.0], atol=1e-6)  # looks forward
    np.testing.assert_allclose(front[:, 3], [1.70, 0.0, 1.51], atol=1e-6)
    np.testing.assert_array_equal(FrameCondition.from_scene(now, maps).action, np.zeros(3))


def failure(capsys: pytest.CaptureFixture[str], arguments: list[str], *sent: bytes) -> str:
    """Error of the command, which fails after the messages ``sent``."""
    capsys.readouterr()
    options: argparse.Namespace = command.parser().parse_args(arguments)
    assert command.run(options, streams.BytesIO(b"".join(sent)), streams.BytesIO()) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = [line for line in printed.err.splitlines() if "was trained with" not in line]
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("pskel.models.pas: ")
    return lines[0].removeprefix("pskel.models.pas: ")


NO_TEXT = "found none (is pskel older than this package?)"


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"protocol": "pskel-planner"}, "expected protocol pskel-denoiser of version 1, found pskel-planner of version 1"),
        ({"version": "2"}, "expected protocol pskel-denoiser of version 1, found pskel-denoiser of version 2"),
        (
            {"sampler": "ddim", "prediction": "epsilon"},
            "expected --sampler flow_match, found ddim with prediction epsilon",
        ),
        ({"window": "1"}, "expected a window of at least 2 frames, found 1"),
        ({"window": "few"}, "expected window as a whole number in the hello, found 'few'"),
        ({"views": "5"}, f"expected cameras as a list of 5 names in the hello, found {json.dumps(CAMERAS)}"),
        ({"cameras": "CAM_FRONT"}, "expected cameras as a list in the hello, found CAM_FRONT"),
        (
            {"cameras": json.dumps(["A"] * 6)},
            "expected cameras with different names, found A, A, A, A, A, A",
        ),
        (
            {"image_sizes": "[[64, 32]]"},
            "expected image_sizes as a list of 6 [width, height] in the hello, found [[64, 32]]",
        ),
        ({"fps": "fast"}, "expected fps as a number in the hello, found 'fast'"),
        ({"fps": "0"}, "expected a positive number of frames per second, found 0.0"),
        ({"fps": None}, f"expected the text fps in the hello, {NO_TEXT}"),
        ({"cameras": None}, f"expected the text cameras in the hello, {NO_TEXT}"),
        ({"image_sizes": None}, f"expected the text image_sizes in the hello, {NO_TEXT}"),
        ({"condition_size": "32"}, "expected condition_size H,W in the hello, found '32'"),
        ({"condition_size": "32,72"}, "expected height and width in multiples of 16 up to 384, found 32x72"),
        ({"condition_size": "32,400"}, "expected height and width in multiples of 16 up to 384, found 32x400"),
    ],
)
def test_other_hellos_are_refused(
    capsys: pytest.CaptureFixture[str], base: Path, changed: dict[str, str | None], expected: str
) -> None:
    texts = {name: text for name, text in {**HELLO, **changed}.items() if text is not None}
    assert failure(capsys, arguments(base), pack(texts, {})) == expected


def test_other_requests_are_refused(capsys: pytest.CaptureFixture[str], base: Path) -> None:
    hello = pack(HELLO, {})
    texts, tensors = request(*window())

    def refused(texts: dict[str, str], tensors: dict[str, Array]) -> str:
        return failure(capsys, arguments(base), hello, pack(texts, tensors))

    short = {name: tensor[:2] for name, tensor in tensors.items()}
    assert refused(texts, short) == "expected the tensor latents of [3, 6, 16, 4, 8], found [2, 6, 16, 4, 8]"
    without = {name: tensor for name, tensor in tensors.items() if name != "action"}
    assert refused(texts, without) == "expected the tensor action of [3, 3], found none"
    prompts = {**texts, "prompts": '["", ""]'}
    assert refused(prompts, tensors) == 'expected prompts as a list of 3 texts in the call, found ["", ""]'
    assert refused({"ask": "train"}, {}) == "expected ask of predict, encode or decode, found train"
    image = {"images": np.zeros((V, 3, H, H), np.float32)}
    assert refused({"ask": "encode"}, image) == "expected the tensor images of [6, 3, 32, 64], found [6, 3, 32, 32]"
    latents = {"latents": np.full_like(tensors["latents"], np.inf)}
    found = refused(texts, {**tensors, **latents})
    assert found == "expected a finite prediction, found infinite or undefined values (is bf16 used?)"


def test_other_streams_are_refused(capsys: pytest.CaptureFixture[str], base: Path) -> None:
    message = pack(HELLO, {})
    found = failure(capsys, arguments(base), message[:100])
    assert found == f"expected a message of {len(message) - 8} bytes, found the end after 92"
    found = failure(capsys, arguments(base), b"GET / HTTP/1.1\r\n")
    assert re.fullmatch(r"expected a message of at most 34359738368 bytes, found \d+", found)
    damaged = b"\x10" + bytes(7) + b"\x08" + bytes(7) + b"not JSON"
    found = failure(capsys, arguments(base), damaged)
    assert found.startswith("expected a message of safetensors with tensors of F32, found 16 bytes: ")
    options = command.parser().parse_args(arguments(base))
    assert command.run(options, streams.BytesIO(), streams.BytesIO()) == 0


def test_messages_are_safetensors() -> None:
    tensors = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.zeros((0, 2), np.float32)}
    stream = streams.BytesIO()
    messages.write(stream, {"x": "é"}, tensors)
    texts, found = unpack(stream.getvalue()[8:])
    assert texts == {"x": "é"} and found.keys() == tensors.keys()
    stream.seek(0)
    again = messages.read(stream)
    assert again is not None and again.texts == texts
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(found[name], tensor)
        np.testing.assert_array_equal(again.tensors[name], tensor)
    assert messages.read(stream) is None


@pytest.mark.parametrize(
    ("missing", "text"),
    [
        ("vae", "vae"),
        ("vae/config.json", "vae/config.json"),
        ("text_encoder_3/model.safetensors", "text_encoder_3/*.safetensors or text_encoder_3/*.bin"),
        ("tokenizer_2", "tokenizer_2"),
        ("tokenizer_3/tokenizer.json", "tokenizer_3/tokenizer.json or tokenizer_3/spiece.model"),
    ],
)
def test_missing_parts_are_named(
    capsys: pytest.CaptureFixture[str], base: Path, tmp_path: Path, missing: str, text: str
) -> None:
    copy = tmp_path / "base"
    shutil.copytree(base, copy)
    path = copy / missing
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    found = failure(capsys, arguments(copy))
    assert found == f"expected a folder of Stable Diffusion 3.5 with {text}, found none: {copy}"


def test_other_files_are_refused(capsys: pytest.CaptureFixture[str], base: Path, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing"
    assert failure(capsys, arguments(nothing)) == f"expected a folder of Stable Diffusion 3.5, found none: {nothing}"
    copy = tmp_path / "base"
    shutil.copytree(base, copy)
    (copy / "vae" / "config.json").write_text("{")
    found = failure(capsys, arguments(copy))
    assert found.startswith("expected a variational autoencoder, found ") and found.endswith(f": {copy / 'vae'}")
    diffusers.AutoencoderKL(block_out_channels=(32,), latent_channels=4).save_pretrained(copy / "vae")
    found = failure(capsys, arguments(copy))
    expected = "expected latents of 16 channels at 1/8 of the size of images, found 4 at 1/1"
    assert found == f"{expected}: {copy / 'vae'}"
    shutil.rmtree(copy / "vae")
    shutil.copytree(base / "vae", copy / "vae")
    (copy / "text_encoder_2" / "model.safetensors").write_bytes(b"damaged")
    found = failure(capsys, arguments(copy))
    assert found.startswith("expected a CLIPTextModelWithProjection, found ")
    assert found.endswith(f": {copy / 'text_encoder_2'}")
    shutil.rmtree(copy / "text_encoder_2")
    shutil.copytree(base / "text_encoder", copy / "text_encoder_2")
    assert failure(capsys, arguments(copy)) == f"expected text encoders of 24 pooled channels, found 8 + 8: {copy}"
    config = tmp_path / "config.json"
    config.write_text('{"colour": 1}')
    found = failure(capsys, arguments(base, config=str(config)))
    assert found == f"expected keys of the network, found colour: {config}"
    weights = tmp_path / "w.pth"
    weights.write_bytes(b"hello, world")
    found = failure(capsys, arguments(base, weights=str(weights)))
    assert found == f"expected a checkpoint of tensors, found a file that begins with b'hello, world': {weights}"
    found = failure(capsys, arguments(base, weights=str(tmp_path / "none.pth")))
    assert found == f"[Errno 2] No such file or directory: '{tmp_path / 'none.pth'}'"


def test_devices_and_memory(capsys: pytest.CaptureFixture[str], base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = failure(capsys, arguments(base, device="tpu"))
    assert found == "expected --device cuda, cuda:N or cpu, found tpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    found = failure(capsys, arguments(base, device="cuda"))
    assert found == "expected a GPU for --device cuda, found 0 that PyTorch can use (--device cpu is slow)"

    def fails(*_: Any) -> None:
        raise torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nMore.")

    monkeypatch.setattr(Denoiser, "__call__", fails)
    found = failure(capsys, arguments(base), pack(HELLO, {}), pack(*request(*window())))
    assert found == (
        "out of memory on cpu with --dtype f32: use bf16, a smaller size in the recipe, a smaller --window or "
        "--cached-frames (CUDA out of memory. Tried to allocate 2.00 GiB.)"
    )


def run_process(arguments: list[str], sent: bytes = b"", **environment: str) -> "subprocess.CompletedProcess[bytes]":
    command = [sys.executable, "-m", "pskel.models.pas", *arguments]
    return subprocess.run(command, env={**os.environ, **environment}, input=sent, capture_output=True, check=False)


@pytest.mark.parametrize(
    ("package", "expected"),
    [
        ("torch", "pskel.models.pas needs PyTorch, diffusers and safetensors: pip install 'pskel[pas]'"),
        ("transformers", "the denoiser of pskel.models.pas needs transformers: pip install 'pskel[pas]'"),
    ],
)
def test_a_missing_package_is_one_line(base: Path, tmp_path: Path, package: str, expected: str) -> None:
    (tmp_path / f"{package}.py").write_text(f"raise ImportError('no {package}')")
    done = run_process(arguments(base), PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stdout, done.stderr.decode()) == (1, b"", f"pskel.models.pas: {expected}\n")


def test_an_error_of_the_process_is_one_line(base: Path) -> None:
    done = run_process(arguments(base), pack({**HELLO, "sampler": "ddim", "prediction": "sample"}, {}))
    expected = "pskel.models.pas: expected --sampler flow_match, found ddim with prediction sample\n"
    assert (done.returncode, done.stdout, done.stderr.decode()) == (1, b"", expected)


def test_invalid_conditions_are_refused(denoiser: Denoiser) -> None:
    arrays = condition_arrays(0)
    for changed, message in [
        ({"layout": arrays["layout"][:, :5]}, "expected layout of [V, 6, H, W], found [6, 5, 32, 64]"),
        ({"points": arrays["points"][:5]}, "expected points of [6, 20, 32, 64], found [5, 20, 32, 64]"),
        ({"action": [1.0]}, "expected action of [3], found [1]"),
        ({"cameras": arrays["cameras"][:, :12]}, "expected cameras of [6, 16], found [6, 12]"),
    ]:
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            FrameCondition.create(**{**arrays, **changed})
    latents, timesteps, sigmas, _ = window()
    frames = [condition(i) for i in range(L)]
    for call, message in [
        ((latents[:, :5], timesteps, sigmas, frames), "expected latents of [3, 6, 16, 4, 8], found [3, 5, 16, 4, 8]"),
        ((latents, timesteps[:2], sigmas, frames), "expected timesteps of [3], found [2]"),
        ((latents[:1], timesteps[:1], sigmas[:1], frames[:1]), "expected at least 2 frames for the motion of the ego, found 1"),
        ((latents, timesteps, sigmas, []), "expected at least 2 frames for the motion of the ego, found 0"),
    ]:
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            denoiser(*call)
