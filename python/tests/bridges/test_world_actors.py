"""Actors without IDs: which track of the log they are, over chunks; and cameras of sessions."""

from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from numpy.typing import NDArray

pytest.importorskip("grpc")
pytest.importorskip("PIL")
from pskel.alpasim import poses, sensorsim_pb2, video_model_pb2  # noqa: E402
from pskel.serve import cameras  # noqa: E402
from pskel.serve.world.actors import Asked, Cast, class_id  # noqa: E402
from pskel.serve.world.views import views  # noqa: E402
from world_client import encoded  # noqa: E402

Array = NDArray[np.float64]
CAR, TRUCK, PEDESTRIAN, CYCLIST, OTHER = range(1, 6)
STEP_US = 33_333


@pytest.fixture(scope="module")
def log() -> pskel.Log:
    return pskel.Log("town:seed=7,frames=16,size=56x100")


def asked(log: pskel.Log, times_us: list[int], moved: Any = None) -> tuple[list[Asked], list[str]]:
    """All actors of the log at some times, sizes in 32 bits, and their tracks; ``moved`` changes a position by track and time."""
    found: dict[str, dict[int, pskel.Actor]] = {}
    for t_us in times_us:
        for actor in log.at(t_us).actors:
            found.setdefault(actor.track, {})[t_us] = actor
    made = []
    for track, path in found.items():
        first = next(iter(path.values()))
        places = {t_us: np.array(actor.global_from_box) for t_us, actor in path.items()}
        for t_us, place in places.items():
            place[:3, 3] += (0, 0, 0) if moved is None else moved(track, t_us)
        made.append(Asked(class_id(first.category), tuple(map(float, np.float32(first.size))), places))  # type: ignore[arg-type]
    return made, list(found)


def times(log: pskel.Log, first: int, frames: int) -> list[int]:
    return [log.times_us[0] + (first + number) * STEP_US for number in range(frames)]


def test_categories_have_the_classes_of_alpasim() -> None:
    expected = {
        "vehicle.car": CAR,
        "vehicle.emergency.police": CAR,
        "vehicle.bus.rigid": TRUCK,
        "vehicle.truck": TRUCK,
        "vehicle.trailer": TRUCK,
        "vehicle.construction": TRUCK,
        "vehicle.bicycle": CYCLIST,
        "vehicle.motorcycle": CYCLIST,
        "human.pedestrian.adult": PEDESTRIAN,
        "human.pedestrian.stroller": PEDESTRIAN,
        "movable_object.trafficcone": OTHER,
        "animal": OTHER,
    }
    assert {category: class_id(category) for category in expected} == expected


def test_tracks_are_found_in_any_order_and_retained(log: pskel.Log) -> None:
    cast, random = Cast(log), np.random.default_rng(1)
    seen: set[str] = set()
    for first in range(0, 80, 8):
        actors, tracks = asked(log, times(log, first, 8))
        order = random.permutation(len(actors))
        roles = cast.roles([actors[index] for index in order])
        assert [role.track for role in roles] == [tracks[index] for index in order]
        known = {actor.track: actor for t_us in times(log, first, 8) for actor in log.at(t_us).actors}
        assert all((role.category, list(role.size)) == (known[role.track].category, known[role.track].size) for role in roles)
        seen |= set(tracks)
    assert len(seen) > 50 and cast.summary == f"{len(seen)} tracks of the log, 0 other actors (0 of class OTHER, not shown)"


def test_actors_that_leave_their_path_retain_their_track(log: pskel.Log) -> None:
    """All cars drive away to the side at 4 m/s, over the paths of others and beyond the reach of their tracks."""
    cars = {actor.track for scene in log for actor in scene.actors if actor.category == "vehicle.car"}
    start_us = log.times_us[0]

    def moved(track: str, t_us: int) -> Array:
        return np.array([0.0, 4e-6 * (t_us - start_us) if track in cars else 0.0, 0.0])

    cast, begun = Cast(log), {actor.track for actor in log.at(start_us).actors}
    for first in range(0, 80, 4):
        actors, tracks = asked(log, times(log, first, 4), moved)
        roles = cast.roles(actors)
        pairs = [(role.track, track) for role, track in zip(roles, tracks, strict=True) if track in begun]
        assert all(found == track for found, track in pairs)
    # Cars that appear beyond the reach of their tracks are no track of the log.
    assert moved(next(iter(cars)), times(log, 79, 1)[0])[1] > 10.0


def test_actors_of_the_same_class_and_size_are_told_apart_by_their_velocity(log: pskel.Log) -> None:
    """Two actors of one size meet at 15 m/s each, at 0.5 m distance: the second chunk begins after they have passed."""
    origin = log.at(log.times_us[0]).ego[:3, 3] + (0.0, 0.0, 500.0)

    def path(y: float, speed: float, first: int, frames: int) -> Asked:
        made = {}
        for t_us in times(log, first, frames):
            made[t_us] = np.eye(4)
            made[t_us][:3, 3] = origin + (speed * ((t_us - log.times_us[0]) * 1e-6 - 0.1 - 1e-3), y, 0.0)
        return Asked(CAR, (4.0, 2.0, 1.5), made)

    cast = Cast(log)
    names = [role.track for role in cast.roles([path(0.0, 15.0, 0, 4), path(0.5, -15.0, 0, 4)])]
    assert names == ["alpasim-1", "alpasim-2"]
    assert [role.track for role in cast.roles([path(0.5, -15.0, 4, 1), path(0.0, 15.0, 4, 1)])] == names[::-1]
    assert [role.track for role in cast.roles([path(0.0, 15.0, 5, 8), path(0.5, -15.0, 5, 8)])] == names
    # The velocity of a single pose is unknown, then that of the last two.
    single = Cast(log)
    for first in range(4):
        assert [role.track for role in single.roles([path(0.0, 35.0, first, 1)])] == ["alpasim-1"]


def test_actors_without_a_track_have_the_template_of_their_class(log: pskel.Log) -> None:
    t_us = log.times_us[2]
    (car,) = [actor for actor in log.at(t_us).actors if actor.category == "vehicle.car"][:1]
    place = np.array(car.global_from_box)
    length, width, height = car.size
    far, near = place.copy(), place.copy()
    near[0, 3] += 0.4
    far[2, 3] += 100.0
    kinds = [
        Asked(CAR, (length, width, height), {t_us: place}),  # the track
        Asked(CAR, (length, width, height), {t_us: near}),  # farther away than the one before
        Asked(TRUCK, (length, width, height), {t_us: place}),  # another class
        Asked(CAR, (length + 2.0, width, height), {t_us: place}),  # another size
        Asked(PEDESTRIAN, (0.5, 0.5, 1.7), {t_us: far}),
        Asked(CYCLIST, (1.8, 0.5, 1.7), {t_us: far}),
        Asked(OTHER, (1.0, 1.0, 1.0), {t_us: far}),
    ]
    for order in (range(7), reversed(range(7))):
        order = list(order)
        cast = Cast(log)
        roles = cast.roles([kinds[index] for index in order])
        found = {index: role for index, role in zip(order, roles, strict=True)}
        assert found[0].track == car.track and found[1].track != car.track
        categories = ["vehicle.car", "vehicle.car", "vehicle.truck", "vehicle.car", "human.pedestrian.adult", "vehicle.bicycle"]
        assert [found[index].category for index in range(7)] == [*categories, "movable_object"]
        assert all(found[index].track.startswith("alpasim-") and found[index].size == kinds[index].size for index in range(2, 7))
        assert len({role.track for role in roles}) == 7
        assert "not shown" in cast.summary and "(1 of class OTHER" in cast.summary


def request(specs: list[sensorsim_pb2.CameraSpec], image: NDArray[np.uint8]) -> video_model_pb2.SessionRequest:
    mount = np.eye(4)
    mount[:3, 3] = (1.5, 0.25, 1.5)
    return video_model_pb2.SessionRequest(
        camera_specs=specs, initial_frames=[encoded(image)] * len(specs), rig_to_camera=[poses.pose(mount)] * len(specs)
    )


def specs() -> dict[str, sensorsim_pb2.CameraSpec]:
    """A camera of 60x100 pixels in each model, all with a focal length of 60 pixels at the center."""
    center = {"principal_point_x": 50.5, "principal_point_y": 29.0}
    focal = {"focal_length_x": 60.0, "focal_length_y": 60.0}
    size = {"resolution_h": 60, "resolution_w": 100}
    kinds: dict[str, Any] = {
        "pinhole": {"opencv_pinhole_param": {**center, **focal}},
        "distorted": {"opencv_pinhole_param": {**center, **focal, "radial_coeffs": [-0.2, 0.03], "tangential_coeffs": [1e-3, 2e-3]}},
        "fisheye": {"opencv_fisheye_param": {**center, **focal, "radial_coeffs": [0.02, -0.005]}},
        "angle": {"ftheta_param": {**center, "reference_poly": 2, "angle_to_pixeldist_poly": [0.0, 60.0, 0.0, -2.0]}},
        "pixels": {
            "ftheta_param": {
                **center,
                "reference_poly": 1,
                "pixeldist_to_angle_poly": [0.0, 1 / 60.0, 0.0, 1e-7],
                "linear_cde": {"linear_c": 1.01, "linear_d": 0.002, "linear_e": -0.001},
            }
        },
    }
    return {name: sensorsim_pb2.CameraSpec(logical_id=name, **size, **fields) for name, fields in kinds.items()}


def test_an_image_and_its_pinhole_image_show_the_same() -> None:
    """A smooth image goes to the pinhole and back: it returns to where it was, within a pixel."""
    v, u = np.mgrid[:60, :100]
    image = np.stack([2 * u, 4 * v, u + v], axis=-1).astype(np.uint8)
    for name, spec in specs().items():
        shown = cameras.projection(spec, (60, 100))
        pinhole = shown.pinhole(image)
        assert pinhole.shape == (*shown.size, 3)
        back = shown.image(pinhole).astype(int)
        inside = back.any(axis=-1)
        assert inside.mean() > 0.99, name
        off = np.abs(back - image)[inside]
        assert off[..., 0].max() <= 4 and off[..., 1].max() <= 8, name  # two pixels at most
        assert off[..., 0].mean() < 1.0 and off[..., 1].mean() < 2.0, name  # half a pixel
        if shown.lens is None:
            np.testing.assert_array_equal(pinhole, image)
            continue
        # Pixels of the pinhole whose rays the lens does not show are black: they are outside the image of an independent model.
        rows, columns = np.mgrid[: shown.size[0], : shown.size[1]]
        x = (columns + 0.5 - shown.intrinsics[0, 2]) / shown.intrinsics[0, 0]
        y = (rows + 0.5 - shown.intrinsics[1, 2]) / shown.intrinsics[1, 1]
        at_u, at_v = MODELS[name](x, y)
        clear = (np.hypot(x, y) < 1.2) & (np.abs(at_u - np.round(at_u)) > 0.02) & (np.abs(at_v - np.round(at_v)) > 0.02)
        seen = clear & (at_u >= 0) & (at_u < 100) & (at_v >= 0) & (at_v < 60)
        assert not pinhole[clear & ~seen].any(), name
        np.testing.assert_array_equal(pinhole[seen], image[at_v[seen].astype(int), at_u[seen].astype(int)], name)
        assert seen.sum() > 3000


def _distorted(x: Array, y: Array) -> tuple[Array, Array]:
    r2 = x**2 + y**2
    radial = 1 - 0.2 * r2 + 0.03 * r2**2
    u = x * radial + 2 * 1e-3 * x * y + 2e-3 * (r2 + 2 * x**2)
    v = y * radial + 1e-3 * (r2 + 2 * y**2) + 2 * 2e-3 * x * y
    return 60 * u + 50.5, 60 * v + 29.0


def _radial(x: Array, y: Array, radius: Any) -> tuple[Array, Array]:
    tangent = np.hypot(x, y)
    scale = radius(np.arctan(tangent)) / tangent
    return x * scale, y * scale


def _fisheye(x: Array, y: Array) -> tuple[Array, Array]:
    u, v = _radial(x, y, lambda angle: 60 * (angle + 0.02 * angle**3 - 0.005 * angle**5))
    return u + 50.5, v + 29.0


def _angle(x: Array, y: Array) -> tuple[Array, Array]:
    u, v = _radial(x, y, lambda angle: 60 * angle - 2 * angle**3)
    return u + 50.5, v + 29.0


def _pixels(x: Array, y: Array) -> tuple[Array, Array]:
    radii = np.linspace(0.0, 120.0, 400_001)
    u, v = _radial(x, y, lambda angle: np.interp(angle, radii / 60.0 + 1e-7 * radii**3, radii))
    return 1.01 * u + 0.002 * v + 50.5, -0.001 * u + v + 29.0


MODELS: dict[str, Any] = {"distorted": _distorted, "fisheye": _fisheye, "angle": _angle, "pixels": _pixels}


def test_cameras_look_along_their_first_axis() -> None:
    """A camera without rotation looks forward; the oracle is a point 10 m ahead, 1 m to the left and 2 m above the camera."""
    (view,) = views(request([specs()["pinhole"]], np.zeros((60, 100, 3), np.uint8)))
    scene = pskel.Scene(np.eye(4), [view.camera])
    x, y, z, _ = scene.camera_from_global[0] @ (1.5 + 10.0, 0.25 + 1.0, 1.5 + 2.0, 1.0)
    np.testing.assert_allclose((x, y, z), (-1.0, -2.0, 10.0), atol=1e-6)


def test_intrinsics_are_in_pixels_of_a_first_frame_of_another_size(tmp_path: Path) -> None:
    """AlpaSim overrides the resolution alone; the image is that of the camera with all numbers scaled."""
    spec = specs()["angle"]
    v, u = np.mgrid[:60, :100]
    image = np.stack([2 * u, 4 * v, u + v], axis=-1).astype(np.uint8)
    scaled = sensorsim_pb2.CameraSpec()
    scaled.CopyFrom(spec)
    scaled.resolution_h, scaled.resolution_w = 30, 50
    (view,) = views(request([scaled], image))
    half = scaled.ftheta_param
    half.principal_point_x, half.principal_point_y = 25.25, 14.5
    half.angle_to_pixeldist_poly[:] = [0.0, 30.0, 0.0, -1.0]
    expected = cameras.projection(scaled, (30, 50))
    np.testing.assert_allclose(view.projection.intrinsics, expected.intrinsics, atol=1e-9)
    assert view.projection.size == expected.size and view.first_frame.shape == (30, 50, 3)
    np.testing.assert_array_equal(view.projection.source, expected.source)
    assert view.image(np.full((56, 100, 3), 77, np.uint8)).shape == (30, 50, 3)
