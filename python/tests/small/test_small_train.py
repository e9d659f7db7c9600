"""The training of the small network: its inputs, its draws, its step."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("safetensors")
import parity  # noqa: E402
import pskel  # noqa: E402
import torch.nn.functional as F  # noqa: E402
from pskel.models.small.augment import Dice, agreeing, augmented  # noqa: E402
from pskel.models.small.draws import DrawOptions, Frames, Statistics, draw_batch, draw_levels, sigmas_of  # noqa: E402
from pskel.models.small.fill import fill  # noqa: E402
from pskel.models.small.levels import Levels  # noqa: E402
from pskel.models.small.losses import Discriminator, answer_loss, guess_errors, similarity, texture_errors  # noqa: E402
from pskel.models.small.network import SmallNetwork  # noqa: E402
from pskel.models.small.weights import load, save  # noqa: E402

STATISTICS = Statistics(*(torch.tensor(each) for each in ((0.4, 0.45, 0.5), (0.2, 0.25, 0.3), (0.3, 0.4, 0.5))))


def frames(length: int = 4) -> Frames:
    """Frames of two cameras; the images are the shades without holes."""
    made = [parity.frame(64, 128, 3, number) for number in range(length)]
    maps = parity.Maps(*(torch.cat(parts) for parts in zip(*(maps for maps, _ in made))))
    images = torch.rand(2 * length, 3, 64, 128, generator=torch.Generator().manual_seed(4))
    return Frames(maps, images, torch.stack([action for _, action in made]))


def draws(seed: int, **options: Any) -> Any:
    options = {"crop": (32, 64), **options}
    return draw_batch([frames(), frames()], STATISTICS, DrawOptions(**options), Dice(torch.Generator().manual_seed(seed)))


@pytest.mark.parametrize("size", [(31, 45), (32, 64), (1, 7)])
def test_holes_are_filled_as_the_program_fills_them(size: tuple[int, int]) -> None:
    random = np.random.default_rng(3)
    color = random.integers(1, 256, (2, *size, 3), dtype=np.uint8)
    depth = np.where(random.random((2, *size)) < 0.2, 5.0, np.inf).astype(np.float32)
    depth[0] = np.inf  # without any point
    expected = pskel.fill_holes(color, depth)
    known = torch.from_numpy(np.isfinite(depth))[:, None].float()
    found = fill(torch.from_numpy(color).permute(0, 3, 1, 2).float() / 255, known)
    off = found.permute(0, 2, 3, 1).numpy() * 255 - expected
    assert np.abs(off).max() <= 0.5 + 1e-3, np.abs(off).max()


def test_similarity_is_that_of_windows() -> None:
    generator = torch.Generator().manual_seed(2)
    truth = torch.rand(2, 3, 20, 24, generator=generator)
    images = (truth + 0.2 * torch.randn(truth.shape, generator=generator)).clamp(0, 1)
    x, y = (
        np.lib.stride_tricks.sliding_window_view(each.double().numpy(), (11, 11), (2, 3)) for each in (images, truth)
    )
    taps = np.exp(-(np.arange(-5, 6) ** 2) / 4.5)
    weights = np.outer(taps, taps) / taps.sum() ** 2

    def mean(values: Any) -> Any:
        return (values * weights).sum((-2, -1))

    mx, my = mean(x), mean(y)
    variances = mean(x * x) - mx**2 + mean(y * y) - my**2
    expected = (2 * mx * my + 1e-4) / (mx**2 + my**2 + 1e-4) * (2 * (mean(x * y) - mx * my) + 9e-4) / (variances + 9e-4)
    assert np.abs(similarity(images, truth).numpy() - expected.mean((1, 2, 3))).max() < 1e-5
    assert (similarity(truth, truth) - 1).abs().max() < 1e-5


def test_texture_errors_are_those_of_contrast_in_blocks() -> None:
    generator = torch.Generator().manual_seed(3)
    truth = torch.rand(2, 3, 25, 33, generator=generator)
    images = truth.clone()
    images[1] = 0.5 + (truth[1] - 0.5) * 1.25
    levels = truth.double().mean(1).numpy()
    right, below = np.diff(levels, axis=2)[:, :-1], np.diff(levels, axis=1)[:, :, :-1]
    blocks = np.hypot(right, below).reshape(2, 3, 8, 4, 8).mean((2, 4))
    found = texture_errors(images, truth)
    assert found[0] == 0
    assert abs(found[1] - 0.25 * blocks[1].mean()) < 1e-4
    # Contrast at other places of a block is as good.
    assert texture_errors(truth.roll((1, 1), (2, 3))[:, :, :24, :24], truth[:, :, :24, :24])[0] < 0.2 * blocks.mean()
    shifted = torch.full((1, 3, 17, 17), 0.5)
    assert texture_errors(shifted + 0.1, shifted)[0] == 0


def test_points_may_have_the_mean_colors_of_the_images() -> None:
    maps, images, _ = frames()
    known = maps.known()[0]
    assert 0.1 < known.mean() < 0.9
    shifted = maps.color * 0.5 + 0.25 + torch.tensor([0.05, 0.0, -0.05])[:, None, None]
    found = agreeing(maps, torch.where(known > 0, maps.color * 0.9, images))
    assert torch.equal(found.known()[0], known) and torch.equal(found.depth, maps.depth)
    off = F.avg_pool2d((found.color - maps.color * 0.9) * known, 32).abs().mean()
    assert off < 0.2 * F.avg_pool2d(0.1 * maps.color * known, 32).abs().mean()
    # A difference that is the same everywhere is gone.
    lowered = maps._replace(color=shifted.clamp(0.05, 0.95) * known)
    found = agreeing(lowered, lowered.color + 0.03)
    assert (found.color - (lowered.color + 0.03) * known).abs().max() < 1e-6


def test_the_target_is_the_answer_that_recovers_clean_latents() -> None:
    generator = torch.Generator().manual_seed(1)
    clean, guess, noise = (torch.randn(1, 3, 1, 3, 2, 2, generator=generator) for _ in range(3))
    sigmas = torch.tensor([[0.01, 0.5, 1.0]])
    levels = Levels(sigmas, STATISTICS.priors)
    s = sigmas[:, :, None, None, None, None]
    noisy = (1 - s) * clean + s * noise
    found = levels.clean(noisy, guess, levels.answer(clean, guess, noise))
    assert (found - clean).abs().max() < 2e-5
    assert (levels.velocity(noisy, clean) - (noise - clean)).abs().max() < 1e-4


def test_levels_are_those_of_a_roll() -> None:
    table = sigmas_of(8, 3.0)
    diffusers = pytest.importorskip("diffusers")
    scheduler = diffusers.FlowMatchEulerDiscreteScheduler(shift=3.0)
    scheduler.set_timesteps(8)
    assert torch.allclose(table, scheduler.sigmas[:8], atol=1e-6)
    expected = {tuple(table[[6, 4, 2, 0]].tolist()), tuple(table[[7, 5, 3, 1]].tolist())}
    dice = Dice(torch.Generator().manual_seed(2))
    seen = set()
    for _ in range(100):
        finished, levels = draw_levels(DrawOptions(staircase=1.0), 4, dice)
        assert levels[:finished].tolist() == [table[7]] * finished
        if finished == 0:
            seen.add(tuple(levels.tolist()))
    assert seen == expected


def test_mirroring_twice_changes_nothing() -> None:
    window = frames(2)

    class Mirror(Dice):
        """Mirrors, and changes nothing else."""

        def unit(self) -> float:
            self.count = getattr(self, "count", 0) + 1
            return 0.0 if self.count == 6 else 1.0

    maps, images, action = window
    for _ in range(2):
        maps, images, action = augmented(maps, images, action, 2, 0.99, Mirror(torch.Generator()))
    assert torch.equal(images, window.images) and torch.equal(action, window.action)
    assert all(torch.equal(a, b) for a, b in zip(maps[1:4], window.maps[1:4]))
    assert torch.allclose(maps.cameras, window.maps.cameras, atol=1e-6)


def test_batches_depend_on_the_seed_alone() -> None:
    first, again, other = draws(1), draws(1), draws(2)
    flat = [torch.cat([each.flatten().double() for each in (*batch.window, *batch[1:])]) for batch in (first, again, other)]
    assert torch.equal(flat[0], flat[1]) and not torch.equal(flat[0], flat[2][: len(flat[0])])
    assert first.window.noisy.shape == (2, 4, 2, 3, 4, 8) and first.planes.shape[1:] == (16, 32, 64)
    # Crops are parts of the images.
    image, top, left = first.places[0].tolist()
    plain = draws(1, augment=0.0)
    at = plain.places[0].tolist()
    whole = torch.cat([frames().images, frames().images])[at[0]]
    assert torch.equal(plain.truth[0], whole[:, 16 * at[1] : 16 * at[1] + 32, 16 * at[2] : 16 * at[2] + 64])
    assert 0 <= image < 16 and top % 2 == 0 and left % 2 == 0


def test_a_network_learns_a_batch() -> None:
    """Answers and images of a fixed batch: a tenth of the loss, which begins at the filled color's."""
    torch.manual_seed(0)
    network = SmallNetwork(parity.SMALL)
    for name, values in zip(("means", "scales", "priors"), STATISTICS):
        getattr(network, name).copy_(values)
    batch = draws(3, augment=0.0, errors=0.0, drop_color=0.0, drop_depth=0.0, drop_layout=0.0, drop_action=0.0, drop_all=0.0)
    optimizer = torch.optim.AdamW(network.parameters(), 4e-3, betas=(0.9, 0.99))
    errors = guess_errors(batch, STATISTICS, 0.4)
    losses = []
    for step in range(300):
        answer, images = network(batch.window, batch.planes, batch.places)
        if step == 0:  # the first images are the filled color
            assert torch.allclose(images, batch.planes[:, :3] / 4 + 0.5, atol=1e-6)
        loss = answer_loss(answer, batch, STATISTICS, errors)
        losses.append(loss.item())
        total = loss + 10 * (images - batch.truth).square().mean()
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
    assert losses[-1] < losses[0] / 10, (losses[0], losses[-1])


def test_the_discriminator_returns_all_layers() -> None:
    outputs = Discriminator()(torch.rand(2, 3, 32, 64), torch.rand(2, 16, 32, 64))
    assert [tuple(each.shape[1:]) for each in outputs] == [(32, 16, 32), (64, 8, 16), (128, 4, 8), (1, 4, 8)]


def test_weights_round_trip_and_others_are_refused(tmp_path: Path) -> None:
    network, path = parity.small(), tmp_path / "w.safetensors"
    save(network, path)
    again = load(path)
    assert again.config == network.config and torch.equal(again.priors, network.priors)
    assert all(torch.equal(a, b) for a, b in zip(network.parameters(), again.parameters()))
    import safetensors.torch

    safetensors.torch.save_file({"a": torch.zeros(1)}, tmp_path / "other")
    with pytest.raises(ValueError, match=r"no network in the header: .*other"):
        load(tmp_path / "other")
    with safetensors.safe_open(path, "pt") as file:
        header = file.metadata()
        arrays = {name: file.get_tensor(name) for name in file.keys()}
    arrays.pop("denoiser.frame")
    safetensors.torch.save_file(arrays, tmp_path / "short", header)
    with pytest.raises(ValueError, match=r"first difference denoiser.frame: .*short"):
        load(tmp_path / "short")
