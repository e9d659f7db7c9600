"""Training of the image variant: options, draws and resumed trainings."""

import json
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("transformers")
from image_base import clip  # noqa: E402
from image_steps import CPU, SIZE, VIEWS, modules, prepared, steps  # noqa: E402
from pskel.models.pas_image.presets import PRESETS  # noqa: E402
from pskel.models.pas_image.task import ImageTask, recipe, task  # noqa: E402
from pskel.train.config import TrainOptions  # noqa: E402
from pskel.train.errors import DataError  # noqa: E402

pytest_plugins = ["image_base"]

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
    if train.startswith("lora"):
        pytest.importorskip("peft")

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
