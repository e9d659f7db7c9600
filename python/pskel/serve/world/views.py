"""Cameras of a session: their projections, their first frames, and the images that are returned."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import grpc
import numpy as np
from numpy.typing import NDArray

import pskel
from pskel.alpasim import poses, sensorsim_pb2, video_model_pb2
from pskel.alpasim.poses import Matrix

from ..cameras import MAX_PIXELS, MAX_SIDE, Projection, projection
from ..errors import RequestError, invalid

Picture = NDArray[np.uint8]

#: Largest number of cameras of a session.
MAX_VIEWS = 8
#: Axes of the optical frame (right, down, forward) in the frame of a camera (forward, left, up).
CAMERA_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
#: Smallest vertical part of an axis that points up.
UPWARD = 0.5
_FORMATS = {video_model_pb2.PNG: "PNG", video_model_pb2.JPEG: "JPEG"}


@dataclass(frozen=True)
class View:
    """A camera: its name, its projection, the pose of its optical frame in the rig, and its first frame ``[H, W, 3]``."""

    name: str
    projection: Projection
    ego_from_camera: Matrix
    first_frame: Picture

    @property
    def camera(self) -> pskel.Camera:
        """The pinhole camera that is rendered."""
        return pskel.Camera(self.name, self.projection.intrinsics, self.projection.size, self.ego_from_camera)

    def reference(self, size: tuple[int, int]) -> Picture:
        """Return the first frame as the image ``[h, w, 3]`` of the pinhole camera."""
        return resized(self.projection.pinhole(self.first_frame), size)

    def image(self, pinhole: Picture) -> Picture:
        """Return the camera's image ``[H, W, 3]`` of an image of the pinhole camera in any size."""
        return self.projection.image(resized(pinhole, self.projection.size))


def views(request: video_model_pb2.SessionRequest) -> list[View]:
    """Return the cameras of a session. Raises ``RequestError``."""
    specs, frames, mounts = request.camera_specs, request.initial_frames, request.rig_to_camera
    if not 1 <= len(specs) <= MAX_VIEWS or not len(specs) == len(frames) == len(mounts):
        found = f"{len(specs)}, {len(frames)} and {len(mounts)}"
        raise invalid(f"as many camera_specs, initial_frames and rig_to_camera, 1 to {MAX_VIEWS}", found)
    names = [spec.logical_id for spec in specs]
    if len(set(names)) < len(names) or not all(names):
        raise invalid("camera_specs with different logical_id", names)
    if (pixels := sum(spec.resolution_h * spec.resolution_w for spec in specs)) > MAX_PIXELS:
        text = f"expected cameras of at most {MAX_PIXELS} pixels, found {pixels}"
        raise RequestError(grpc.StatusCode.RESOURCE_EXHAUSTED, text)
    result = []
    for spec, frame, mount in zip(specs, frames, mounts, strict=True):
        try:
            result.append(_view(spec, frame, poses.matrix(mount)))
        except RequestError as error:
            raise RequestError(error.code, f"camera {spec.logical_id}: {error}") from None
        except ValueError as error:
            raise RequestError(grpc.StatusCode.INVALID_ARGUMENT, f"rig_to_camera of {spec.logical_id}: {error}") from None
    return result


def _view(spec: sensorsim_pb2.CameraSpec, frame: video_model_pb2.Image, mount: Matrix) -> View:
    # An optical frame has the image's down axis below: taken for (forward, left, up) it is rolled by a quarter turn.
    if mount[2, 2] < UPWARD <= -mount[2, 1]:
        raise invalid("rig_to_camera of a camera whose axes are forward, left, up", "one whose axes are right, down, forward")
    picture = _decoded(frame)
    size = (spec.resolution_h, spec.resolution_w)
    if picture.shape[:2] != size:
        spec = _of_frame(spec, picture.shape[1], picture.shape[0])
        picture = resized(picture, size)
    return View(spec.logical_id, projection(spec, size), mount @ CAMERA_FROM_OPTICAL, picture)


def _of_frame(spec: sensorsim_pb2.CameraSpec, width: int, height: int) -> sensorsim_pb2.CameraSpec:
    """Return a specification whose intrinsics are in pixels of the first frame, which has another size than the resolution.

    AlpaSim overrides the resolution alone: intrinsics remain those of the recorded image. Raises ``RequestError`` if the principal
    point does not agree.
    """
    kind = spec.WhichOneof("camera_param")
    if kind is None or not (spec.resolution_h and spec.resolution_w):
        raise invalid("the parameters and the resolution of a camera", "none")
    param = getattr(spec, kind)
    center = np.array([param.principal_point_x, param.principal_point_y])
    off = [float(np.abs(center / size - 0.5).max()) for size in ((width, height), (spec.resolution_w, spec.resolution_h))]
    if not off[0] <= off[1]:
        raise invalid(f"intrinsics in pixels of the first frame, {height}x{width}", f"a principal point at {center.tolist()}")
    changed = sensorsim_pb2.CameraSpec()
    changed.CopyFrom(spec)
    changed.resolution_h, changed.resolution_w = height, width
    return changed


def _decoded(frame: video_model_pb2.Image) -> Picture:
    """Return a first frame ``[H, W, 3]``. Raises ``RequestError`` for other formats, damaged data and too large images."""
    from PIL import Image

    expected = _FORMATS.get(frame.format)
    if expected is None:
        names = {number: name for name, number in video_model_pb2.ImageFormat.items()}
        raise invalid("an initial frame as PNG or JPEG", names.get(frame.format, frame.format))
    try:
        with Image.open(io.BytesIO(frame.data), formats=[expected]) as image:
            width, height = image.size
            if max(width, height) > MAX_SIDE or width * height > MAX_PIXELS:
                text = f"expected an initial frame of at most {MAX_PIXELS} pixels, found {height}x{width}"
                raise RequestError(grpc.StatusCode.RESOURCE_EXHAUSTED, text)
            return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise invalid(f"an initial frame as {expected}", f"{len(frame.data)} bytes: {error}") from None


def resized(image: Picture, size: Sequence[int]) -> Picture:
    """Return an image in a size (height, width): Pillow's BILINEAR, which is a triangle filter as wide as the scale."""
    from PIL import Image

    height, width = size
    if image.shape[:2] == (height, width):
        return image
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize((width, height), Image.Resampling.BILINEAR))
