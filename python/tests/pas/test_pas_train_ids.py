"""Camera numbers: the published nuPlan weights take (fx/H, 0, cx/W, fy/H), all others (fx/H, fy/H, cx/W, cy/H)."""

import os
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
safetensors = pytest.importorskip("safetensors.torch")
from pskel.models._rig import PUBLISHED, Rig  # noqa: E402
from pskel.models.pas import added_time_ids  # noqa: E402
from pskel.models.pas.ids import ids_from_motion  # noqa: E402

SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
STEPS = Path(os.environ.get("PSKEL_FIXTURES", SHARED / "fixtures")) / "pas-train"
needs_fixture = pytest.mark.skipif(not STEPS.exists(), reason="pas-train is not there (set PSKEL_SHARED)")

WIDTH, HEIGHT = 1600.0, 900.0
FX, FY, CX, CY = 1500.0, 1490.0, 820.0, 440.0
EXPECTED = {
    "fx,fy,cx,cy": [FX / HEIGHT, FY / HEIGHT, CX / WIDTH, CY / HEIGHT],
    "fx,0,cx,fy": [FX / HEIGHT, 0.0, CX / WIDTH, FY / HEIGHT],
}


@needs_fixture
@pytest.mark.parametrize(
    ("file", "kind"), [("nuscenes", "fx,fy,cx,cy"), ("nuplan", "fx,0,cx,fy")], ids=["nuscenes", "nuplan"]
)
def test_numbers_equal_the_authors(file: str, kind: Any) -> None:
    tensors = safetensors.load_file(STEPS / f"{file}.safetensors")
    step = "points.step0" if file == "nuplan" else "step0"
    raw = {name.removeprefix("batch."): tensor for name, tensor in tensors.items()}
    arguments = raw["camera_intrinsics"], raw["image_size"], raw["camera_transforms"], raw["ego_transforms"], raw["fps"]
    expected = tensors[f"{step}.added_time_ids"]
    assert float((added_time_ids(*arguments, camera_numbers=kind) - expected).abs().max()) < 1e-4
    other = "fx,0,cx,fy" if kind == "fx,fy,cx,cy" else "fx,fy,cx,cy"
    found: Any = added_time_ids(*arguments, camera_numbers=other)  # type: ignore[arg-type]
    difference = (found - expected).abs().amax((0, 1, 2))
    assert (difference[[2, 4]] > 0.4).all() and (difference[[0, 1, 3, *range(5, 13)]] < 1e-4).all()


@pytest.mark.parametrize("kind", list(EXPECTED))
def test_numbers_by_hand(kind: Any) -> None:
    intrinsics = torch.tensor([[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]]).expand(1, 2, 1, 3, 3)
    poses = torch.eye(4).expand(1, 2, 1, 4, 4)
    sizes = torch.tensor([WIDTH, HEIGHT]).expand(1, 2, 1, 2)
    ids = added_time_ids(intrinsics, sizes, poses, poses, 5.0, camera_numbers=kind)
    assert ids[0, 0, 0, 1:5].tolist() == pytest.approx(EXPECTED[kind], rel=1e-6)
    fractions = torch.tensor([FX / WIDTH, FY / HEIGHT, CX / WIDTH, CY / HEIGHT])
    cameras = torch.cat([torch.eye(4)[:3].flatten(), fractions]).expand(2, 1, 16)
    moved = ids_from_motion(cameras, sizes[0, 0], torch.zeros(2, 3), 5.0, camera_numbers=kind)
    assert moved[0, 0, 1:5].tolist() == pytest.approx(EXPECTED[kind], rel=1e-6)


def test_rates_of_clips() -> None:
    """Speed and the first number follow the rate of each clip: 2 m per frame at 5 and 10 Hz are 36 and 72 km/h."""
    poses = torch.eye(4, dtype=torch.float64).repeat(2, 3, 1, 1, 1)
    poses[:, :, 0, 0, 3] = torch.tensor([0.0, 2.0, 4.0], dtype=torch.float64)
    eye, sizes = torch.eye(4).expand(2, 3, 1, 4, 4), torch.ones(2, 3, 1, 2)
    ids = added_time_ids(eye, sizes, eye, poses, torch.tensor([5.0, 10.0]))
    assert ids[:, :, 0, 0].tolist() == [[5.0] * 3, [10.0] * 3]
    assert ids[:, :, 0, 11].flatten().tolist() == pytest.approx([36.0] * 3 + [72.0] * 3)


def test_rigs_of_published_checkpoints() -> None:
    found = {known.name: Rig(known.cameras, ((1920, 1080),) * len(known.cameras), known.fps) for known in PUBLISHED}
    assert {name: rig.camera_numbers for name, rig in found.items()} == {
        "nuScenes": "fx,fy,cx,cy",
        "nuPlan": "fx,0,cx,fy",
    }
    assert Rig(("A", "B"), ((64, 32),) * 2, 5.0).camera_numbers == "fx,fy,cx,cy"


def test_other_kinds_are_rejected() -> None:
    eye = torch.eye(4).expand(1, 2, 1, 4, 4)
    with pytest.raises(ValueError, match="^expected camera numbers of fx,fy,cx,cy or fx,0,cx,fy, found fx,fy$"):
        added_time_ids(eye, torch.ones(1, 2, 1, 2), eye, eye, 2.0, camera_numbers="fx,fy")  # type: ignore[arg-type]


class _Network:
    """Records the numbers it gets; nothing else is asked of it."""

    def __init__(self, config: Any) -> None:
        self.config = config
        self.ids: list[Any] = []

    def encode_view(self, ids: Any) -> Any:
        self.ids.append(ids[0, 0])
        return torch.zeros(*ids.shape[:3], 1)

    def encode_layout(self, maps: Any) -> Any:
        return (torch.zeros(*maps.shape[:3], 1, 1),)

    encode_points = encode_layout

    def encode_text(self, tokens: Any, pooled: Any) -> Any:
        return tokens, pooled

    def __call__(self, sample: Any, *_: Any) -> Any:
        return sample


@pytest.mark.parametrize(
    ("names", "chosen", "expected"),
    [
        (PUBLISHED[1].cameras, None, "fx,0,cx,fy"),
        (PUBLISHED[1].cameras, "fx,fy,cx,cy", "fx,fy,cx,cy"),
        (PUBLISHED[0].cameras, None, "fx,fy,cx,cy"),
        (PUBLISHED[0].cameras, "fx,0,cx,fy", "fx,0,cx,fy"),
    ],
)
def test_a_denoiser_takes_those_of_the_checkpoint(names: tuple[str, ...], chosen: Any, expected: str) -> None:
    pytest.importorskip("transformers")
    import numpy as np
    from pskel.models.pas import Config, Denoiser, FrameCondition, Models

    class Codec:
        device = torch.device("cpu")

    def text(prompt: str) -> Any:
        return torch.zeros(1, 1), torch.zeros(1)

    network = _Network(Config())
    models = Models(network, Codec(), text)  # type: ignore[arg-type]
    rig = Rig(names, ((int(WIDTH), int(HEIGHT)),) * len(names), 5.0)
    denoiser = Denoiser(models, rig, camera_numbers=chosen)
    fractions = [FX / WIDTH, FY / HEIGHT, CX / WIDTH, CY / HEIGHT]
    cameras = np.tile([*np.eye(4)[:3].flatten(), *fractions], (len(names), 1))
    maps = np.zeros((len(names), 20, 16, 16)), np.zeros((len(names), 6, 16, 16))
    frames = [FrameCondition.create(*maps, np.zeros(3), cameras)] * 2
    denoiser(np.zeros((2, *denoiser.latent_shape((16, 16)))), np.zeros(2), np.zeros(2), frames)
    assert len(network.ids) == 2
    for ids in network.ids:
        assert ids[:, 1:5].tolist() == [pytest.approx(EXPECTED[expected], rel=1e-6)] * len(names)
