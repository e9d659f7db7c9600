"""Pixels and rays of cameras with lenses, against py123d's pixels (tests/peers/lenses.py)."""

import json
from pathlib import Path

import numpy as np
import pskel
import pytest

PEERS = Path(__file__).parents[2] / "tests" / "peers" / "lenses.json"


def test_pixels_equal_those_of_py123d() -> None:
    for peer in json.loads(PEERS.read_text())["cameras"]:
        size = peer["height"], peer["width"]
        if "mei" in peer:
            camera = pskel.Camera.fisheye_mei(peer["name"], **peer["mei"], size=size, ego_from_camera=np.eye(4))
        else:
            camera = pskel.Camera.f_theta(peer["name"], peer["f_theta"], size, np.eye(4))
        points = np.array(peer["points"])
        pixels = camera.project(points)
        np.testing.assert_allclose(pixels, peer["pixels"], atol=1e-6)
        rays = points / np.linalg.norm(points, axis=1, keepdims=True)
        np.testing.assert_allclose(camera.unproject(pixels), rays, atol=1e-6)


def test_what_a_lens_does_not_show_is_nan() -> None:
    sizes, lens = (100, 100), ([-1 / 3, 0.0, 0.0, 0.0], [100.0, 100.0, 50.0, 50.0])
    fisheye = pskel.Camera.fisheye_mei("fisheye", 1.0, *lens, sizes, np.eye(4))
    assert np.isnan(fisheye.project([[0.0, 1.0, -0.1], [0.0, 0.0, 0.0]])).all()
    assert np.isnan(fisheye.unproject([[500.0, 50.0]])).all()
    pinhole = pskel.Camera("pinhole", [[80, 0, 50], [0, 90, 40], [0, 0, 1]], sizes, np.eye(4))
    np.testing.assert_allclose(pinhole.project([[1.0, 2.0, 4.0]]), [[70.0, 85.0]])
    np.testing.assert_allclose(pinhole.unproject([[50.0, 40.0]]), [[0.0, 0.0, 1.0]], atol=1e-15)  # rounding
    assert np.isnan(pinhole.project([[0.0, 0.0, -1.0]])).all()
    with pytest.raises(ValueError, match=r"expected points \[N, 3\]"):
        pinhole.project([[1.0, 2.0]])
    with pytest.raises(ValueError, match="expected a mirror parameter of 0 or more"):
        pskel.Camera.fisheye_mei("fisheye", -1.0, *lens, sizes, np.eye(4))


def test_scenes_return_their_cameras(log: pskel.Log) -> None:
    scene = log[0]
    camera = scene.camera(scene.cameras[1])
    assert camera.name == scene.cameras[1]
    pixels = [[3.0, 5.0], [70.5, 20.25]]
    rays = camera.unproject(pixels)
    image = rays @ scene.intrinsics[1].T
    np.testing.assert_allclose(image[:, :2] / image[:, 2:], pixels, atol=1e-9)
    with pytest.raises(KeyError, match="expected the name of a camera"):
        scene.camera("CAM_TOP")
