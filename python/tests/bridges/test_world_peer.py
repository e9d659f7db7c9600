"""The world model with AlpaSim's own client, VideoModelService, in scenes that are exported for AlpaSim.

The client needs an environment of AlpaSim (alpasim_runtime, alpasim_utils, alpasim_grpc and utils_rs); its Python is named by
PSKEL_ALPASIM_PYTHON.
"""

import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest

pytest.importorskip("grpc")
pytest.importorskip("PIL")
from pskel.alpasim import poses, video_model_pb2  # noqa: E402
from pskel.serve.cameras import projection  # noqa: E402
from pskel.serve.world.views import CAMERA_FROM_OPTICAL, resized  # noqa: E402
from sensorsim_client import decoded, run  # noqa: E402
from world_client import FAKES, in_process, pictures, server  # noqa: E402
from world_fakes import Fake  # noqa: E402

PYTHON = os.environ.get("PSKEL_ALPASIM_PYTHON")
CLIENT = Path(__file__).parent / "alpasim_world_client.py"
SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
PANDASET = SHARED / "data/pandaset-002/nuscenes"
FRAMES = 60
#: Logs and the size of the images, which is that of the first frames in the town, a quarter of it in PandaSet.
LOGS = {"town": ("town:seed=7,frames=16,size=113x200", "113x200"), "pandaset": (f"nuscenes:{PANDASET}@v1.0-mini", "270x480")}

pytestmark = pytest.mark.skipif(PYTHON is None, reason="needs an environment of AlpaSim (PSKEL_ALPASIM_PYTHON)")


@pytest.fixture(scope="module", params=list(LOGS))
def scene(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, Path, str]:
    """A log, its skeleton, its USDZ file and the size of the images."""
    folder = tmp_path_factory.mktemp(request.param)
    name, size = LOGS[request.param]
    if request.param == "pandaset" and not PANDASET.exists():
        pytest.skip(f"needs {PANDASET}")
    try:
        pskel.export(name, folder / "usdz", layout="alpasim", skeletons=folder / "skeletons")
    except ValueError as error:
        pytest.skip(str(error))
    run("build", name, "--frames=0..4", "--voxel=0.1", f"--out={folder / 'skeleton'}")
    return name, folder / "skeleton", next((folder / "usdz").glob("*.usdz")), size


@pytest.mark.parametrize("generator", ["fake:1:3", "fill"])
def test_images_equal_the_loop_in_one_process(scene: tuple[str, Path, Path, str], tmp_path: Path, generator: str) -> None:
    name, skeleton, usdz, size = scene
    fake = generator.startswith("fake")
    with server(str(skeleton), f"--log={name}", f"--generator={generator}", **({"program": FAKES} if fake else {})) as (_, address):
        assert PYTHON is not None
        command = [PYTHON, str(CLIENT), address, str(usdz), str(tmp_path), str(FRAMES), "0.5", size]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1200, env={**os.environ, "PYTHONPATH": ""})
        assert done.returncode == 0, done.stderr
    start = video_model_pb2.SessionRequest.FromString((tmp_path / "session").read_bytes())
    count = len(list(tmp_path.glob("*.request")))
    chunks = [video_model_pb2.VideoChunkRequest.FromString((tmp_path / f"{n}.request").read_bytes()) for n in range(count)]
    answers = [video_model_pb2.VideoChunkReturn.FromString((tmp_path / f"{n}.response").read_bytes()) for n in range(count)]
    assert [len(chunk.rig_trajectory.poses) for chunk in chunks] == [5] + [8] * (count - 1)
    assert len(start.camera_specs) == 6 and all(spec.WhichOneof("camera_param") == "ftheta_param" for spec in start.camera_specs)

    log = pskel.Log(name)
    height, width = map(int, size.split("x"))
    frames = [decoded(frame.data) for frame in start.initial_frames]
    for spec, frame in zip(start.camera_specs, frames, strict=True):  # the intrinsics are in pixels of the first frame
        assert (spec.resolution_h, spec.resolution_w) == (height, width)
        spec.resolution_h, spec.resolution_w = frame.shape[:2]
    projections = [projection(spec, (height, width)) for spec in start.camera_specs]
    cameras = [
        pskel.Camera(spec.logical_id, shown.intrinsics, shown.size, poses.matrix(mount) @ CAMERA_FROM_OPTICAL)
        for spec, mount, shown in zip(start.camera_specs, start.rig_to_camera, projections, strict=True)
    ]
    check_mounts(cameras, log)
    first = log.at(log.times_us[0])
    kind: Any = Fake if fake else pskel.Generator
    options = {"log": log.name, "prompt": "", "noise_seed": 0}
    made = kind(generator, pskel.Scene(first.ego, cameras, map_of=first), fps=30.0, **options)
    renderer = pskel.Renderer(pskel.Skeleton(skeleton), maps=["color", "depth"], log=log.name)
    references = np.stack(
        [
            resized(shown.pinhole(resized(frame, (height, width))), made.image_size)
            for shown, frame in zip(projections, frames, strict=True)
        ]
    )
    expected = in_process(made, renderer, log, start, chunks, cameras, references)
    found = pictures(answers)
    assert found.shape[:2] == (sum(len(chunk.rig_trajectory.poses) for chunk in chunks), 6) and len(found) >= FRAMES
    for index, shown in enumerate(projections):
        images = np.stack([shown.image(resized(image, shown.size)) for image in expected[:, index]])
        np.testing.assert_array_equal(found[:, index], images, cameras[index].name)
    assert len(np.unique(found.reshape(len(found), -1)[:, ::97], axis=0)) == len(found)


def check_mounts(cameras: list[pskel.Camera], log: pskel.Log) -> None:
    """Check that each camera is mounted as one of the log: axes in messages are taken for what they are."""
    scene = log.at(log.times_us[0])
    found = pskel.Scene(scene.ego, cameras).camera_from_global
    for camera, view in zip(cameras, found, strict=True):
        assert min(np.abs(view - other).max() for other in scene.camera_from_global) < 1e-2, camera.name
