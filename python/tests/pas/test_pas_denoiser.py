"""The video network of *Point as Skeleton* as a denoiser and codec, in another process and in this one."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from pas_base import Array, Peer, unpack

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
transformers = pytest.importorskip("transformers")
from pas_frames import (  # noqa: E402
    CAMERAS,
    FIXTURE,
    FPS,
    IMAGE_SIZES,
    SHAPE,
    TRAINED,
    H,
    L,
    V,
    W,
    condition,
    condition_arrays,
    dropped,
    needs_fixture,
    request,
    window,
)
from pskel.models.pas import Config, Denoiser, FrameCondition, Models, Rig, added_time_ids  # noqa: E402
from pskel.models._cache import Cache  # noqa: E402
from pskel.models.pas.ids import ids_from_motion  # noqa: E402
from pskel.models._rig import PUBLISHED, inverse, ring_mask  # noqa: E402

pytest_plugins = ["pas_frames"]
pytestmark = needs_fixture


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
    """Encode prompts with the diffusers pipeline: tokens and pooled tokens."""
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
    """Numbers computed from fractions and motions equal numbers computed from pixels and poses."""
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
