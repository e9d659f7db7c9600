"""Arrays of other programs: masks, types, units and origins."""

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt
import pskel
import pytest
from pskel._arrays import numbers

EYE = np.eye(4)[None]
K = np.array([[[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]])
POINTS = np.array([[0.0, 0.0, 5.0, 255, 0, 0], [0.0, 0.0, 10.0, 0, 255, 0]])
MUNICH = np.array([691603.25, 5335787.75, 520.5])


def splat(points: Any, intrinsics: Any = K, pose: Any = EYE) -> Any:
    return pskel.splat(points, intrinsics, pose, (48, 64), schedule="100:0", rasterizer="cpu")


def masked(array: npt.NDArray[np.float64]) -> Any:
    mask = np.zeros(array.shape, bool)
    mask[0] = True
    return np.ma.masked_array(array, mask)


def scene() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Points at UTM coordinates, and a camera before them."""
    random = np.random.default_rng(1)
    offsets = random.uniform([-4, -3, 5], [4, 3, 20], (400, 3))
    colors = random.integers(2, 256, (400, 3))
    pose = np.eye(4)
    pose[:3, 3] = -MUNICH
    return np.hstack([MUNICH + offsets, colors]), pose[None]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_masked_values_are_refused(tmp_path: Any) -> None:
    found = "expected an array without masked values, found 6 masked"
    for points in (masked(POINTS), [masked(POINTS)[0], POINTS[1]], (POINTS[0], masked(POINTS)[0])):
        with pytest.raises(TypeError, match=found):
            splat(points)
    with pytest.raises(TypeError, match="masked values"):
        splat(POINTS, masked(K))
    with pytest.raises(TypeError, match="masked values"):
        splat(POINTS, K, masked(EYE))
    with pytest.raises(TypeError, match="masked values"):
        splat([[0.0, 0.0, np.ma.masked, 1, 2, 3]])
    with pytest.raises(TypeError, match=found):
        pskel.Skeleton.from_points(tmp_path / "sk", masked(POINTS))
    with pytest.raises(TypeError, match=found):
        pskel.Skeleton.from_points(tmp_path / "sk", POINTS, {"a": ("vehicle.car", (4.0, 2.0, 1.5), masked(POINTS))})
    with pytest.raises(TypeError, match="masked values"):
        pskel.Camera("front", masked(K[0]), (48, 64), EYE[0])
    with pytest.raises(TypeError, match="masked values"):
        pskel.Camera("front", K[0], (48, 64), masked(EYE[0]))
    with pytest.raises(TypeError, match="masked values"):
        pskel.Actor("a", "vehicle.car", (4.0, 2.0, 1.5), masked(EYE[0]))
    with pytest.raises(TypeError, match="masked values"):
        pskel.Scene(masked(EYE[0]), [])
    color = np.ma.masked_array(np.zeros((1, 2, 2, 3), np.uint8), True)
    with pytest.raises(TypeError, match="masked values"):
        pskel.fill_holes(color, np.zeros((1, 2, 2), np.float32))
    with pytest.raises(TypeError, match="masked"):
        numbers(masked(POINTS))
    assert not (tmp_path / "sk").exists()


def test_masked_arrays_without_masked_values_are_arrays() -> None:
    maps = splat(np.ma.masked_array(POINTS, False))
    assert maps["depth"][0, 24, 32] == 5.0
    points = masked(POINTS)
    assert splat(points[~points.mask.any(axis=1)].data)["depth"][0, 24, 32] == 10.0


def test_numbers_of_all_types_give_the_same_maps() -> None:
    expected = splat(POINTS)
    for dtype in (">f8", ">f4", "<f2", np.longdouble, np.int16, ">i4", np.uint16):
        found = splat(POINTS.astype(dtype))
        for name in ("color", "depth", "point"):
            np.testing.assert_array_equal(found[name], expected[name], f"{dtype} {name}")
    for points in (
        POINTS.astype(complex),
        POINTS.astype(object),
        POINTS.astype(bool),
        POINTS.astype(str),
        POINTS.astype("M8[s]"),
        np.zeros(2, [("x", float), ("y", float)]),
    ):
        with pytest.raises(TypeError, match="expected an array of real numbers"):
            splat(points)
    with pytest.raises(TypeError, match="real numbers"):
        numbers([True, False])


def test_missing_values_of_pandas_are_refused() -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(POINTS)
    np.testing.assert_array_equal(splat(frame)["depth"], splat(POINTS)["depth"])
    nullable = frame.astype("Float64")
    nullable.iloc[0, 2] = pandas.NA
    with pytest.raises((TypeError, ValueError), match="expected (an array of real numbers|finite positions)"):
        splat(nullable)


def test_one_far_point_does_not_change_the_maps_of_the_others() -> None:
    points, pose = scene()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain = splat(points, pose=pose)
    for far in ([0.0, 0.0, 0.0], [0.0, 0.0, -1e20], [391780.5, 5820070.25, 34.0]):
        for first in (True, False):
            lost = np.array([[*far, 0, 0, 0]])
            both = np.vstack([lost, points] if first else [points, lost])
            with pytest.warns(UserWarning, match="points: 1 of 401 points lie more than 16384 m from the origin"):
                maps = splat(both, pose=pose)
            np.testing.assert_array_equal(maps["depth"], plain["depth"])
            np.testing.assert_array_equal(maps["color"], plain["color"])
            shifted = np.where(plain["point"] > 0, plain["point"] + int(first), 0)
            np.testing.assert_array_equal(maps["point"], shifted)


def test_single_precision_far_from_zero_is_warned_of() -> None:
    points, pose = scene()
    expected = "400 of 400 points lie more than 16384 m from zero in single precision: rounded by up to 0.250 m"
    with pytest.warns(UserWarning, match=expected):
        splat(points.astype(np.float32), pose=pose)


def test_skeletons_refuse_points_beyond_all_limits(tmp_path: Any) -> None:
    far = np.vstack([POINTS, [[0.0, 0.0, -1e20, 1, 2, 3]]])
    with pytest.raises(ValueError, match=r"within 100000000 m of zero, found \[0.0, 0.0, -1e20\] at point 2 of background"):
        pskel.Skeleton.from_points(tmp_path / "sk", far)
    with pytest.raises(ValueError, match="at point 2 of points of asset 'a'|asset \"a\""):
        pskel.Skeleton.from_points(tmp_path / "sk", POINTS, {"a": ("vehicle.car", (4.0, 2.0, 1.5), far)})
    with pytest.raises(ValueError, match="size above 0 and up to 100000 m"):
        pskel.Skeleton.from_points(tmp_path / "sk", POINTS, {"a": ("vehicle.car", (4.0, 1e308, 1.5), POINTS)})
    moved = np.eye(4)
    moved[0, 3] = 3e38
    with pytest.raises(ValueError, match="within 100000000 m of the origin"):
        splat(POINTS, pose=moved[None])
    assert not (tmp_path / "sk").exists()


def test_colors_from_0_to_1_are_scaled_with_a_warning() -> None:
    unit = POINTS.copy()
    unit[:, 3:] = [[1.0, 0.5, 0.0], [0.0, 0.25, 1.0]]
    with pytest.warns(UserWarning, match="points: colors of 0 to 1, scaled to 0 to 255"):
        maps = splat(unit)
    assert maps["color"][0, 24, 32].tolist() == [255, 128, 0]
    unit[:, 3:] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    with pytest.warns(UserWarning, match="no color exceeds 1 of 255: nearly black"):
        maps = splat(unit)
    assert maps["color"][0, 24, 32].tolist() == [1, 0, 0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        splat(unit.astype(np.int64))
