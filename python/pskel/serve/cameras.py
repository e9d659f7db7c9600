"""Camera models of requests, rendered as pinholes.

``u`` and ``v`` are positions in the image: pixel (column c, row r) covers c to c+1 and r to r+1, as in docs/src/reference/maps.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import grpc
import numpy as np
from numpy.typing import NDArray

from pskel.alpasim import sensorsim_pb2
from pskel.alpasim.sensorsim_pb2 import CameraSpec

from .errors import RequestError, invalid

Array = NDArray[np.float64]

#: Largest side of an image, pixels, and largest number of pixels that are rendered for one image.
MAX_SIDE = 16384
MAX_PIXELS = 64 << 20
#: Largest angle to the optical axis that a pinhole can show, radians.
MAX_ANGLE = math.radians(80.0)
#: A lens is inverted where its model returns to within this distance, pixels.
INVERTED_PX = 0.05


@dataclass(frozen=True)
class Projection:
    """A camera as the pinhole that is rendered: intrinsics ``[3, 3]`` and size (height, width), pixels.

    ``source`` has for each pixel of the image, ``int64 [H, W]``, the index of its pixel in the pinhole image, -1 if no ray reaches
    it. ``lens`` maps points ``[.., 2]`` of the plane z = 1 to positions in the image, ``nan`` outside the lens. Both are ``None`` if
    the image is the pinhole's.
    """

    intrinsics: Array
    size: tuple[int, int]
    source: NDArray[np.int64] | None
    lens: Callable[[Array], Array] | None

    def image(self, pinhole: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the camera's image ``[H, W, 3]`` of a pinhole image: the nearest pixel of each ray, black without one."""
        if self.source is None:
            return pinhole
        flat = np.concatenate([pinhole.reshape(-1, 3), np.zeros((1, 3), np.uint8)])
        return flat[self.source]

    def pinhole(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the pinhole image of a camera's image ``[H, W, 3]``: the nearest pixel of each ray, black outside the image."""
        if self.lens is None or self.source is None:
            return image
        height, width = self.source.shape
        at = self.lens(_plane(self.intrinsics, self.size))
        with np.errstate(invalid="ignore"):
            inside = ((at >= 0.0) & (at < (width, height))).all(axis=-1, keepdims=True)
        column, row = np.moveaxis(np.where(inside, at, 0.0).astype(np.int64), -1, 0)
        return np.where(inside, image[row, column], np.uint8(0))


def projection(spec: CameraSpec, size: tuple[int, int]) -> Projection:
    """Return the projection of a camera at a size (height, width), with scaled intrinsics.

    Raises ``RequestError`` for models that are unknown, not finite, not invertible, or wider than 160 degrees.
    """
    height, width = size
    if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE):
        raise invalid(f"an image size of 1 to {MAX_SIDE} pixels", f"{height}x{width}")
    if spec.WhichOneof("external_distortion"):
        raise RequestError(grpc.StatusCode.UNIMPLEMENTED, "expected a camera without a windshield, found one")
    scale = np.array([width / (spec.resolution_w or width), height / (spec.resolution_h or height)])
    kind = spec.WhichOneof("camera_param")
    if kind == "opencv_pinhole_param":
        return _pinhole(spec.opencv_pinhole_param, size, scale)
    if kind == "opencv_fisheye_param":
        return _fisheye(spec.opencv_fisheye_param, size, scale)
    if kind == "ftheta_param":
        return _ftheta(spec.ftheta_param, size, scale)
    raise invalid("the parameters of a camera", "none")


def matrix(param: sensorsim_pb2.OpenCVPinholeCameraParam | sensorsim_pb2.OpenCVFisheyeCameraParam, scale: Array) -> Array:
    """Return scaled intrinsics ``[3, 3]``. Raises ``RequestError`` if they are not finite or focal lengths not positive."""
    focal = np.array([param.focal_length_x, param.focal_length_y]) * scale
    center = np.array([param.principal_point_x, param.principal_point_y]) * scale
    if not (np.isfinite(focal).all() and np.isfinite(center).all() and (focal > 0.0).all()):
        raise invalid("finite intrinsics with positive focal lengths", f"{focal.tolist()} and {center.tolist()}")
    return np.array([[focal[0], 0.0, center[0]], [0.0, focal[1], center[1]], [0.0, 0.0, 1.0]])


def _pinhole(param: sensorsim_pb2.OpenCVPinholeCameraParam, size: tuple[int, int], scale: Array) -> Projection:
    intrinsics = matrix(param, scale)
    k = _numbers("radial_coeffs", param.radial_coeffs, 6)
    p = _numbers("tangential_coeffs", param.tangential_coeffs, 2)
    s = _numbers("thin_prism_coeffs", param.thin_prism_coeffs, 4)
    if not (k.any() or p.any() or s.any()):
        return Projection(intrinsics, size, None, None)
    wanted = _plane(intrinsics, size)
    found = wanted.copy()
    for _ in range(100):  # x = (x_d - offset(x)) / factor(x)
        factor, offset = _brown_conrady(found, k, p, s)
        with np.errstate(all="ignore"):
            found = (wanted - offset) / factor[..., None]
    factor, offset = _brown_conrady(found, k, p, s)
    with np.errstate(all="ignore"):
        error = np.abs((found * factor[..., None] + offset - wanted) * intrinsics[[0, 1], [0, 1]]).max(axis=-1)
    known = (error < INVERTED_PX) & (factor > 0.0)

    def lens(xy: Array) -> Array:
        factor, offset = _brown_conrady(xy, k, p, s)
        return (xy * factor[..., None] + offset) * intrinsics[[0, 1], [0, 1]] + intrinsics[:2, 2]

    return _remapped(intrinsics, size, np.where(known[..., None], found, np.nan), lens)


def _brown_conrady(xy: Array, k: Array, p: Array, s: Array) -> tuple[Array, Array]:
    """Return radial factor ``[..]`` and offset ``[.., 2]`` of OpenCV's model with 12 coefficients at points of the plane z = 1."""
    x, y = xy[..., 0], xy[..., 1]
    with np.errstate(all="ignore"):
        r2 = x * x + y * y
        factor = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))) / (1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5])))
        along = 2.0 * p[0] * x * y + p[1] * (r2 + 2.0 * x * x) + s[0] * r2 + s[1] * r2 * r2
        down = p[0] * (r2 + 2.0 * y * y) + 2.0 * p[1] * x * y + s[2] * r2 + s[3] * r2 * r2
    return factor, np.stack([along, down], axis=-1)


def _fisheye(param: sensorsim_pb2.OpenCVFisheyeCameraParam, size: tuple[int, int], scale: Array) -> Projection:
    intrinsics = matrix(param, scale)
    k = _numbers("radial_coeffs", param.radial_coeffs, 4)
    powers = np.zeros(10)
    powers[1::2] = [1.0, *k]
    angles = _inverse(powers, param.max_angle)
    plane = _plane(intrinsics, size)

    def lens(xy: Array) -> Array:
        return angles.positions(xy) * intrinsics[[0, 1], [0, 1]] + intrinsics[:2, 2]

    return _remapped(intrinsics, size, _rays(plane, angles), lens)


def _ftheta(param: sensorsim_pb2.FthetaCameraParam, size: tuple[int, int], scale: Array) -> Projection:
    if abs(scale[0] - scale[1]) > 1e-3 * scale[0]:
        raise invalid("an image of the camera's aspect ratio for an f-theta camera", f"{size[0]}x{size[1]}")
    kind = sensorsim_pb2.FthetaCameraParam
    center = np.array([param.principal_point_x, param.principal_point_y]) * scale
    to_angle = np.array(param.pixeldist_to_angle_poly, dtype=np.float64)
    to_pixels = np.array(param.angle_to_pixeldist_poly, dtype=np.float64)
    by_pixels = param.reference_poly == kind.PIXELDIST_TO_ANGLE or not len(to_pixels)
    used = to_angle if by_pixels else to_pixels
    if len(used) < 2 or not np.isfinite(used).all() or used[1] <= 0.0 or not np.isfinite(center).all():
        raise invalid("finite f-theta polynomials that rise from 0", used.tolist())
    focal = (1.0 / used[1] if by_pixels else used[1]) * scale[0]
    angles = _polynomial(used, param.max_angle) if by_pixels else _inverse(used, param.max_angle)
    # Positions are [[c, d], [e, 1]] times the polynomial's positions.
    cde = param.linear_cde
    stretch = np.array([[cde.linear_c or 1.0, cde.linear_d], [cde.linear_e, 1.0]])
    if not np.isfinite(stretch).all() or abs(np.linalg.det(stretch)) < 1e-6:
        raise invalid("an invertible linear_cde", stretch.tolist())
    u, v = _pixels(size)
    plane = np.stack([u - center[0], v - center[1]], axis=-1) @ np.linalg.inv(stretch).T / scale[0]
    intrinsics = np.array([[focal, 0.0, center[0]], [0.0, focal, center[1]], [0.0, 0.0, 1.0]])

    def lens(xy: Array) -> Array:
        moved: Array = angles.positions(xy) @ stretch.T * scale[0] + center
        return moved

    return _remapped(intrinsics, size, _rays(plane, angles), lens)


def _pixels(size: tuple[int, int]) -> tuple[Array, Array]:
    """Return the positions u and v of all pixels' centers, ``[H, W]``."""
    v, u = np.mgrid[: size[0], : size[1]] + 0.5
    return u, v


def _plane(intrinsics: Array, size: tuple[int, int]) -> Array:
    """Return the points ``[H, W, 2]`` of the plane z = 1 that a pinhole shows at its pixels' centers."""
    u, v = _pixels(size)
    (fx, _, cx), (_, fy, cy), _ = intrinsics
    return np.stack([(u - cx) / fx, (v - cy) / fy], axis=-1)


def _rays(plane: Array, angles: _Angles) -> Array:
    """Return points ``[H, W, 2]`` of the plane z = 1 for points whose distance to the axis gives the angle to it."""
    radius = np.linalg.norm(plane, axis=-1)
    angle = angles(radius)
    with np.errstate(all="ignore"):
        stretch = np.where(radius > 0.0, np.tan(angle) / radius, 1.0)
    return plane * np.where(angle < MAX_ANGLE, stretch, np.nan)[..., None]


class _Angles:
    """Angles to the optical axis, radians, by the distance to it: a table; ``nan`` beyond its end."""

    def __init__(self, radius: Array, angle: Array) -> None:
        self._radius, self._angle = radius, angle

    def __call__(self, radius: Array) -> Array:
        return np.interp(radius, self._radius, self._angle, right=np.nan)

    def positions(self, plane: Array) -> Array:
        """Return for points ``[.., 2]`` of the plane z = 1 those whose distance to the axis gives their angle; ``nan`` beyond the end."""
        tangent = np.linalg.norm(plane, axis=-1)
        radius = np.interp(np.arctan(tangent), self._angle, self._radius, right=np.nan)
        with np.errstate(all="ignore"):
            stretch = np.where(tangent > 0.0, radius / tangent, 1.0)
        moved: Array = plane * stretch[..., None]
        return moved


def _inverse(powers: Array, max_angle: float) -> _Angles:
    """Return the inverse of a polynomial from angles to distances, up to where it stops to rise."""
    if not np.isfinite(powers).all():
        raise invalid("finite coefficients of a lens", powers.tolist())
    end = max_angle if 0.0 < max_angle < MAX_ANGLE else MAX_ANGLE
    angle = np.linspace(0.0, end, 20_001)
    return _Angles(*_rising(_valued(angle, powers), angle))


def _polynomial(powers: Array, max_angle: float) -> _Angles:
    """Return a polynomial from distances to angles, up to where it stops to rise."""
    end = max_angle if 0.0 < max_angle < MAX_ANGLE else MAX_ANGLE
    radius = np.linspace(0.0, 2.0 * MAX_SIDE, 200_001)
    angle, radius = _rising(_valued(radius, powers), radius)
    count = int(np.searchsorted(angle, end))
    return _Angles(radius[:count], angle[:count])


def _valued(positions: Array, powers: Array) -> Array:
    """Return the values of a polynomial with rising powers."""
    values: Array = np.polynomial.polynomial.polyval(positions, powers)  # type: ignore[assignment]
    return values


def _rising(values: Array, positions: Array) -> tuple[Array, Array]:
    """Return the leading part of both arrays, as long as the values rise."""
    falls = np.flatnonzero(~(np.diff(values) > 0.0))
    count = int(falls[0]) + 1 if len(falls) else len(values)
    return values[:count], positions[:count]


def _remapped(intrinsics: Array, size: tuple[int, int], plane: Array, lens: Callable[[Array], Array]) -> Projection:
    """Return a projection by the points of the plane z = 1 at its pixels, ``nan`` without one, and its model.

    The model is used up to the largest distance to the axis among these points: farther out it may turn back.
    """
    (fx, _, cx), (_, fy, cy), _ = intrinsics
    known = np.isfinite(plane).all(axis=-1) & (np.hypot(plane[..., 0], plane[..., 1]) < math.tan(MAX_ANGLE))
    if not known.any():
        raise invalid("a lens that can be inverted", "none of its pixels")
    u = np.floor(plane[..., 0] * fx + cx, where=known, out=np.zeros(size))
    v = np.floor(plane[..., 1] * fy + cy, where=known, out=np.zeros(size))
    left, top = u[known].min(), v[known].min()
    width, height = int(u[known].max() - left) + 1, int(v[known].max() - top) + 1
    if width > MAX_SIDE or height > MAX_SIDE or width * height > MAX_PIXELS:
        raise invalid(f"a lens that a pinhole of {MAX_SIDE} pixels and 160 degrees shows", f"one of {height}x{width}")
    source = np.where(known, (v - top) * width + (u - left), -1.0).astype(np.int64)
    moved = intrinsics - np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
    reach = 1.01 * float(np.linalg.norm(plane[known], axis=-1).max())

    def limited(xy: Array) -> Array:
        return np.where(np.linalg.norm(xy, axis=-1, keepdims=True) <= reach, lens(xy), np.nan)

    return Projection(moved, (height, width), source, limited)


def _numbers(name: str, given: object, most: int) -> Array:
    """Return coefficients, filled up with zeros. Raises ``RequestError`` if there are too many, or they are not finite."""
    values = np.array(list(given), dtype=np.float64)  # type: ignore[call-overload]
    if len(values) > most or not np.isfinite(values).all():
        raise invalid(f"at most {most} finite {name}", values.tolist())
    return np.pad(values, (0, most - len(values)))
