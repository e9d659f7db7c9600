"""Training of the image variant: options, draws, resumed trainings, and one clip learned by heart and then driven."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
from image_base import Array, Peer, clip, unpack  # noqa: E402
from image_frames import HELLO, arguments  # noqa: E402
from image_rollout import roll_out, run_loop, through  # noqa: E402
from pskel.models.pas_image import Denoiser, FrameCondition, Models, Rig  # noqa: E402
from pskel.models.pas_image.presets import PRESETS  # noqa: E402
from pskel.models.pas_image.task import ImageTask, recipe, task  # noqa: E402
from pskel.train.config import TrainOptions  # noqa: E402
from pskel.train.errors import DataError  # noqa: E402
from safetensors.torch import save_file  # noqa: E402

pytest_plugins = ["image_base"]

CPU = torch.device("cpu")
SIZE = (32, 56)
VIEWS = 2


def prepared(base: Path, **options: Any) -> ImageTask:
    torch.manual_seed(1)
    made = task({"base": str(base), **options}, TrainOptions())
    made.prepare(iter([clip(views=VIEWS, size=SIZE)]))
    return made


def modules(made: ImageTask) -> dict[str, Any]:
    return {player.name: player.module for player in made.players}


def steps(made: ImageTask, optimizer: Any, numbers: range, clips: int = 2) -> list[float]:
    """Take training steps; returns the losses."""
    losses = []
    for number in numbers:
        batch = made.draw([clip(0, views=VIEWS, size=SIZE)] * clips, number, 0, 0)
        loss, _ = made.loss("network", batch, modules(made), CPU)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(made.network.parameters(), 1.0)
        optimizer.step()
        losses.append(float(loss.detach()))
    return losses


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"colour": 1}, "expected the options base, train, recipe, .*, found 'colour'"),
        ({"train": "lora"}, "expected train of all, adapters or lora:R with a rank R, found 'lora'"),
        ({"train": "all:2"}, "expected train of all, adapters or lora:R with a rank R, found 'all:2'"),
        ({"train": "lora:0"}, "expected lora_rank above 0 for trained lora alone, found 0 for lora"),
        ({"recipe": "pas"}, "expected recipe of pas-image-nuscenes, pas-image-nuplan, found 'pas'"),
        ({"drop_text": "often"}, "expected drop_text of type float, found 'often'"),
        ({"drop_text": 2}, "expected drop_text of 0 to 1, found 2.0"),
        ({"infer_steps": 0}, "expected inference steps of 1 to 1000, found 0"),
        ({"image_batch": 0}, "expected image_batch of at least 1, found 0"),
        ({"history_level": 1000}, "expected history_level of 0 to 999, found 1000"),
        ({"zero_snr": True}, "expected prediction velocity with zero_snr, found epsilon"),
    ],
)
def test_other_options_are_refused(base: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        task({"base": str(base), **options}, TrainOptions())


def test_a_base_is_needed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="^expected base, a folder of Stable Diffusion 1.5, found none$"):
        task({}, TrainOptions())
    with pytest.raises(
        ValueError, match=f"^expected a folder of Stable Diffusion 1.5 with unet, found none: {tmp_path}$"
    ):
        task({"base": tmp_path}, TrainOptions())


def test_recipes_are_those_of_the_presets() -> None:
    assert recipe({}) == PRESETS["pas-image-nuscenes"].recipe
    assert recipe({"recipe": "pas-image-nuplan"})["drawn"] == "1080x1920"
    for preset in PRESETS.values():
        assert (preset.recipe["size"], preset.window, preset.steps, preset.guidance) == ("224x400", 2, 20, 2.0)
        assert preset.steps % preset.window == 0


def test_clips_that_do_not_fit_are_errors_of_the_data(base: Path) -> None:
    made = prepared(base)
    with pytest.raises(
        DataError, match=r"expected height and width in multiples of 8, found 32x60: log log-a, frame 0"
    ):
        made.draw([clip(size=(32, 60))], 0, 0, 0)
    with pytest.raises(DataError, match="expected clips of at least 2 frames, found 1"):
        made.prepare(iter([clip(frames=1)]))


def test_draws_depend_on_seed_step_and_rank(base: Path) -> None:
    made, given = prepared(base), [clip(views=VIEWS, size=SIZE)]
    first = made.draw(given, 3, 5, 1).draws
    assert all(torch.equal(a, b) for a, b in zip(first, made.draw(given, 3, 5, 1).draws))
    for key in ((4, 5, 1), (3, 6, 1), (3, 5, 0)):
        assert not torch.equal(made.draw(given, *key).draws.noise, first.noise)


@pytest.mark.parametrize("train", ["all", "adapters", "lora:2"])
def test_a_resumed_training_has_the_same_losses(base: Path, train: str) -> None:
    def begun() -> tuple[ImageTask, Any]:
        made = prepared(base, train=train, checkpointing=train == "all")
        return made, torch.optim.AdamW(made.players[0].groups, lr=1e-3)

    made, optimizer = begun()
    untouched = {n: p.detach().clone() for n, p in made.network.named_parameters() if not p.requires_grad}
    expected = steps(made, optimizer, range(4))
    assert len(set(expected)) == 4
    assert all(torch.equal(dict(made.network.named_parameters())[n], p) for n, p in untouched.items())

    made, optimizer = begun()
    found = steps(made, optimizer, range(2))
    saved = made.network.state_dict(), optimizer.state_dict(), json.loads(json.dumps(made.state()))
    saved = torch.utils._pytree.tree_map(lambda x: x.clone() if torch.is_tensor(x) else x, saved)
    torch.manual_seed(99)
    made = task({"base": str(base), "train": train, "checkpointing": train == "all"}, TrainOptions())
    made.network.load_state_dict(saved[0])
    made.load_state(saved[2])
    optimizer = torch.optim.AdamW(made.players[0].groups, lr=1e-3)
    optimizer.load_state_dict(saved[1])
    assert found + steps(made, optimizer, range(2, 4)) == expected
    assert made.training is not None and made.training.size == SIZE


def test_the_loss_is_the_one_of_the_step(base: Path) -> None:
    """With latents, texts and noise put together here."""
    made = prepared(base, drop_text=1.0)
    batch = made.draw([clip(7, views=VIEWS, size=SIZE)], 0, 0, 0)
    with torch.no_grad():
        loss, numbers = made.loss("network", batch, modules(made), CPU)
        images = batch.batch.images.flatten(0, 2).float() / 127.5 - 1
        posterior = made._codec.vae.encode(images).latent_dist
        noise = batch.draws.posterior_noise.flatten(0, 2)
        latents = 0.18215 * (posterior.mean + posterior.std * noise)
        from pskel.models.pas_image.step import levels_of, noisy_inputs

        timesteps, is_counted = levels_of(batch.draws, made.step)
        tokens = made._text.encode_all(batch.batch.texts)
        inputs, _ = noisy_inputs(
            batch.batch, tokens, latents.view(1, 2, VIEWS, 4, 4, 7), batch.draws, made.schedule, made.config, made.step
        )
        assert torch.equal(inputs.text, made._text("").expand(1, 2, VIEWS, -1, -1))
        errors = (made.network(inputs) - batch.draws.noise).square()
    expected = errors[is_counted].mean()
    assert float(loss) == pytest.approx(float(expected), rel=1e-5)
    assert set(numbers) == ({"free"} if is_counted.all() else {"after_previous"})


def test_weights_need_data(base: Path) -> None:
    made = task({"base": str(base)}, TrainOptions())
    with pytest.raises(RuntimeError, match="expected a call of prepare or load_state before weights, found none"):
        made.weights(modules(made))


class Learned(NamedTuple):
    """A training on one clip."""

    task: ImageTask
    before: float
    after: float
    weights: Path


def fixed_loss(made: ImageTask) -> float:
    """Mean loss over draws that the training has not seen."""
    with torch.no_grad():
        batches = [made.draw([clip(views=VIEWS, size=SIZE)] * 4, number, 12345, 0) for number in range(8)]
        losses = [float(made.loss("network", batch, modules(made), CPU)[0]) for batch in batches]
    return math.fsum(losses) / len(losses)


@pytest.fixture(scope="module")
def learned(base: Path, tmp_path_factory: pytest.TempPathFactory) -> Learned:
    made = prepared(base, infer_steps=4)
    before = fixed_loss(made)
    count, rate = 260, 4e-3
    optimizer = torch.optim.AdamW(made.players[0].groups, lr=rate, weight_decay=0.0)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: 1.0 - step / count)
    for number in range(count):
        steps(made, optimizer, range(number, number + 1), clips=4)
        schedule.step()
    made.network.eval()
    path = tmp_path_factory.mktemp("learned") / "weights.safetensors"
    tensors, texts = made.weights(modules(made))
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path, texts)
    return Learned(made, before, fixed_loss(made), path)


def test_a_clip_is_learned_by_heart(learned: Learned) -> None:
    assert learned.before > 0.9  # the noise has a variance of 1
    assert learned.after < 0.1 * learned.before, learned


def test_held_out_clips_are_scored_and_shown(learned: Learned) -> None:
    given = clip(views=VIEWS, size=SIZE)
    with torch.no_grad():
        scores, again = (learned.task.scores(given, modules(learned.task)) for _ in range(2))
        pictures = learned.task.pictures(given, modules(learned.task))
    assert scores == again and set(scores) == {"loss", "psnr_db"} and scores["loss"] < 0.3
    assert pictures.dtype is torch.uint8 and pictures.shape == (4, 3, 32, VIEWS * 56)
    assert torch.equal(pictures[3], torch.cat(list(given.images[-1]), dim=-1))
    assert torch.equal(pictures[0], torch.cat(list(given.color[-1]), dim=-1))
    error = (pictures[2].float() - pictures[3].float()).square().mean() / 255**2
    assert scores["psnr_db"] == pytest.approx(-10 * math.log10(float(error)), abs=0.1)


COUNT, STEPS, GUIDANCE = 20, 4, 2.0


def condition(number: int) -> FrameCondition:
    """Conditions of a frame of the closed loop: those of the learned clip, in turn."""
    given = clip(views=VIEWS, size=SIZE)
    frame = number % 2
    bins = given.bins[frame].numpy().astype(np.float32)
    depth = np.where(bins == 0, -1.0, np.minimum(bins, 255) / 255)[:, None]
    points = np.concatenate([given.color[frame].numpy() / 255, depth], axis=1).astype(np.float32)
    layout = torch.cat([given.boxes[frame], given.map[frame]], dim=1).numpy() / 255
    return FrameCondition.create(points, layout, given.action[1].numpy(), given.cameras[frame].numpy(), "camera 1")


@pytest.fixture(scope="module")
def models(learned: Learned, base: Path) -> Models:
    return Models.load(learned.weights, base, dtype=torch.float32, device="cpu")


@pytest.fixture(scope="module")
def denoiser(models: Models) -> Denoiser:
    return Denoiser(models, Rig(clip(views=VIEWS).names, ((1600, 900),) * VIEWS, 2.0))


@pytest.fixture(scope="module")
def new_denoiser(models: Models, base: Path) -> Denoiser:
    """Of a network before its training."""
    new = replace(models, network=prepared(base).network.eval())
    return Denoiser(new, Rig(clip(views=VIEWS).names, ((1600, 900),) * VIEWS, 2.0))


@pytest.fixture(scope="module")
def peer(learned: Learned, base: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Peer]:
    errors = tmp_path_factory.mktemp("peer") / "errors.txt"
    peer = Peer(arguments(base, learned.weights), errors, "pskel.models.pas_image")
    changed = {
        "views": str(VIEWS),
        "condition_size": "32,56",
        "cameras": json.dumps(clip(views=VIEWS).names),
        "image_sizes": json.dumps([[1600, 900]] * VIEWS),
    }
    assert unpack(peer.ask({**HELLO, **changed}, {}))[0]["latent_shape"] == f"{VIEWS},4,4,7"
    yield peer
    assert peer.close() == 0
    assert peer.errors.read_text() == ""  # the inputs are those of the training


def reference(denoiser: Denoiser) -> Array:
    return denoiser.encode(clip(views=VIEWS, size=SIZE).images[0].numpy() / 255)


def fixed_noise(shape: tuple[int, ...]) -> list[list[Array]]:
    random = np.random.default_rng(6)
    return [[random.normal(size=shape).astype(np.float32) for _ in range(2)] for _ in range(COUNT)]


def test_the_learned_clip_is_driven(denoiser: Denoiser, new_denoiser: Denoiser, peer: Peer) -> None:
    """A closed loop of 20 steps: the same latents in this process and in another one, nearer to the recorded ones."""
    conditions = [condition(number) for number in range(COUNT + 4)]
    first = reference(denoiser)
    noise = fixed_noise(first.shape)
    ours = roll_out(denoiser, first, conditions, noise, STEPS, GUIDANCE)
    theirs = roll_out(through(peer), first, conditions, noise, STEPS, GUIDANCE)
    assert len(ours) == len(theirs) == COUNT
    for frame, other in zip(ours, theirs):
        assert np.isfinite(frame).all()
        np.testing.assert_array_equal(frame, other)
    recorded = denoiser.encode(clip(views=VIEWS, size=SIZE).images[1].numpy() / 255)
    lost = roll_out(new_denoiser, first, conditions, noise[:4], STEPS, GUIDANCE)

    def error(frame: Array) -> float:
        return float(np.sqrt(np.mean((frame - recorded) ** 2)))

    # Frames have the conditions of the recorded ones in turn.
    assert max(map(error, ours[::2])) < min(map(error, lost[::2])) / 3


def test_the_loop_of_the_package_gives_the_same(denoiser: Denoiser) -> None:
    pytest.importorskip("pskel._pskel")
    first = reference(denoiser)
    # A network that finds no noise shows the noise of the loop: a new frame is last in the first call of a roll.
    seen: list[Array] = []

    def still(latents: Array, timesteps: Array, sigmas: Array, _: list[FrameCondition]) -> Array:
        if timesteps[-1] == 751.0:  # the first of four steps
            seen.append(latents[-1].copy())
        return np.zeros_like(latents)

    count = 3
    run_loop(still, first, condition, count, STEPS, 1.0)
    assert len(seen) == count * 2
    noise = [seen[2 * step : 2 * step + 2] for step in range(count)]
    expected = roll_out(denoiser, first, [condition(i) for i in range(count + 4)], noise, STEPS, GUIDANCE)
    found = run_loop(denoiser, first, condition, count, STEPS, GUIDANCE)
    for ours, packaged in zip(expected, found):
        np.testing.assert_array_equal(ours, packaged)
