"""Generates lenses.json: rays projected by py123d, the reference for src/geometry/lens. Compares it with pskel.

Run: python3 tests/peers/lenses.py           (py123d 0.7.0, numpy 2.4) writes lenses.json
     python3 tests/peers/lenses.py --compare (and pskel) projects 10,000 rays per camera by both, and back

py123d computes the same formulas, but neither limits the angle nor marks rays at 90 degrees and more as visible. Its depth of a
MEI camera at exactly 90 degrees is 0/0. Rays here are up to the angle that the lens shows.
"""

import json
import pathlib
import sys

import numpy as np
from py123d.datatypes.sensors.base_camera import CameraID
from py123d.datatypes.sensors.fisheye_mei_camera import FisheyeMEICameraMetadata, FisheyeMEIDistortion, FisheyeMEIProjection
from py123d.datatypes.sensors.ftheta_camera import FThetaCameraMetadata, FThetaIntrinsics
from py123d.geometry import PoseSE3

# width, height, largest angle in degrees, mirror parameter, k1 k2 p1 p2, gamma1 gamma2 u0 v0
MEI = {
    # The first is image_02.yaml of KITTI-360.
    "kitti-360 image_02": (
        1400, 1400, 116.5, 2.2134047507854890, [1.6798235660113681e-02, 1.6548773243373522, 4.2223943394772046e-04, 4.2462134260997584e-04],
        [1.3363220825849971e03, 1.3357883350012958e03, 7.1694323510126321e02, 7.0576498308221585e02],
    ),
    "more distortion": (1400, 1400, 113.0, 2.55, [4.9e-02, 4.5, 1.3e-03, -7.0e-04], [1485.4, 1484.9, 698.9, 698.1]),
    "catadioptric": (800, 600, 140.0, 0.9, [-0.01, 0.001, 0.0, 0.0], [500.0, 510.0, 401.5, 299.0]),
}  # fmt: skip
# width, height, largest angle in degrees, cx cy, 6 forward coefficients
F_THETA = {
    "120 degrees": (1920, 1080, 110.0, [960.0, 540.0], [0.0, 900.0, 5.0, -30.0, 2.0, 0.0]),
    "30 degrees": (1920, 1208, 30.0, [957.3, 603.8], [0.02, 3651.0, -1.1, 210.0, -12.0, 3.0]),
}
MOUNT = PoseSE3(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def points(count: int, degrees: float, seed: int) -> np.ndarray:
    """Return points up to an angle from the axis."""
    rng = np.random.default_rng(seed)
    angle, turn = np.radians(degrees) * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    rays = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], 1)
    rays[0] = [0, 0, 1]
    return rays * rng.uniform(0.5, 80, count)[:, None]


def cameras() -> list[tuple[dict, float, object]]:
    """Return the numbers of each camera, its largest angle, and py123d's camera."""
    found = []
    for name, (width, height, degrees, xi, distortion, projection) in MEI.items():
        given = FisheyeMEIDistortion(*distortion), FisheyeMEIProjection(*projection)
        peer = FisheyeMEICameraMetadata(name, CameraID.FMCAM_L, xi, *given, width, height, MOUNT)
        numbers = {"mirror_parameter": xi, "distortion": distortion, "projection": projection}
        found.append(({"name": name, "width": width, "height": height, "mei": numbers}, degrees, peer))
    for name, (width, height, degrees, center, forward) in F_THETA.items():
        given = FThetaIntrinsics(*center, np.array(forward), np.zeros(6))
        peer = FThetaCameraMetadata(name, CameraID.FTCAM_F0, given, width, height, MOUNT)
        found.append(({"name": name, "width": width, "height": height, "f_theta": [*center, *forward, *[0.0] * 6]}, degrees, peer))
    return found


def write() -> None:
    """Write lenses.json: 60 points per camera."""
    rows = []
    for seed, (numbers, degrees, peer) in enumerate(cameras()):
        where = points(60, degrees, seed)
        rows.append({**numbers, "points": where.tolist(), "pixels": peer.project_to_image(where)[0].tolist()})
    path = pathlib.Path(__file__).with_name("lenses.json")
    path.write_text(json.dumps({"cameras": rows}, separators=(",", ":")) + "\n")


def compare() -> None:
    """Print the largest distances from py123d's pixels, and of rays after a round trip."""
    import pskel

    for seed, (numbers, degrees, peer) in enumerate(cameras()):
        name, size = numbers["name"], (numbers["height"], numbers["width"])
        if "mei" in numbers:
            camera = pskel.Camera.fisheye_mei(name, *numbers["mei"].values(), size, np.eye(4))
        else:
            camera = pskel.Camera.f_theta(name, numbers["f_theta"], size, np.eye(4))
        where = points(10_000, degrees, 100 + seed)
        expected = peer.project_to_image(where)[0]
        found, rays = camera.project(where), camera.unproject(expected)
        off = np.linalg.norm(found - expected, axis=1).max()
        turned = np.linalg.norm(rays - where / np.linalg.norm(where, axis=1)[:, None], axis=1).max()
        print(f"{name}: {off:.1e} px, rays {turned:.1e}")
        assert off <= 0.01 and turned <= 1e-5, name


compare() if "--compare" in sys.argv else write()
