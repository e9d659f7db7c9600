"""The world dreamer of DriveArena as a generator of images."""

from __future__ import annotations

import io
import math
import sys
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pskel._nuscenes import COMMANDS, LIDAR_FROM_EGO
from pskel.images import Hello, ImageGenerator, ImageRequest, RequestActor

from . import CAMERAS, HZ, SIZE
from .server import Server
from .road_map import CELLS, REACH_M, RoadMap

__all__ = ["Dreamer"]

#: Classes of the dreamer, in the order of its numbers.
LABELS = (
    "car", "truck", "construction_vehicle", "bus", "trailer", "barrier", "motorcycle", "bicycle", "pedestrian", "traffic_cone",
)  # fmt: skip
#: Words of categories and the labels they mean, in the order in which they are tested.
WORDS = {
    "construction_worker": "pedestrian", "pedestrian": "pedestrian", "trailer": "trailer", "construction": "construction_vehicle",
    "truck": "truck", "bus": "bus", "motorcycle": "motorcycle", "bicycle": "bicycle", "barrier": "barrier",
    "trafficcone": "traffic_cone", "traffic_cone": "traffic_cone", "car": "car",
}  # fmt: skip
#: Labels of other categories by the class of an actor; other actors are not sent.
CLASSES = {"motor_vehicle": "car", "pedestrian": "pedestrian", "cycle": "bicycle"}
_GRAVITY = 9.8


class Dreamer(ImageGenerator):
    """One rollout. The server keeps its last images itself, as references of the next ones."""

    image_size = SIZE
    maps = ()
    references = 0

    def __init__(self, server: Server, hello: Hello, road_map: RoadMap | None, location: str, description: str | None) -> None:
        if sorted(hello.cameras) != sorted(CAMERAS):
            raise ValueError(f"expected the cameras {', '.join(CAMERAS)}, found {', '.join(hello.cameras)}")
        if abs(hello.fps - HZ) > 1e-6:
            raise ValueError(f"expected --plan-hz 2, the rate of DriveArena's world dreamer, found {hello.fps:g}")
        self._server, self._map, self._location, self._description = server, road_map, location, description
        self._next, self._last_pose = 0, None
        self._unsent: Counter[str] = Counter()
        server.get("/dreamer-clean/")

    def generate(self, request: ImageRequest) -> npt.NDArray[np.uint8]:
        """Ask for the images of a planning step; raises ``ValueError`` for answers that are not six images of 224x400."""
        if request.frame != self._next:
            expected = f"expected frame {self._next} of a rollout, found {request.frame}"
            raise ValueError(f"{expected}: the world dreamer keeps its last images itself, so that rollouts cannot be resumed")
        self._next += 1
        images = images_of(self._server.post("/dreamer-api/", self._conditions(request)))
        return images[[CAMERAS.index(name) for name in request.cameras]]

    def _conditions(self, request: ImageRequest) -> dict[str, Any]:
        pose = request.global_from_ego[0]
        last, self._last_pose = pose if self._last_pose is None else self._last_pose, pose
        boxes, labels = boxes_of(request.actors[0], pose, self._unsent)
        lines: Any = ([], [])
        drivable = np.zeros((CELLS, CELLS), np.bool_)
        if self._map is not None:
            lidar = pose @ np.linalg.inv(LIDAR_FROM_EGO)
            place = (float(lidar[0, 3]), float(lidar[1, 3]), math.atan2(pose[1, 0], pose[0, 0]))
            lines, drivable = self._map.lines(*place), self._map.drivable(*place)
            if not drivable.any() and not lines[0]:
                raise ValueError(f"expected a map of the log's place, found nothing within {REACH_M:g} m of {place[0]:.1f}, {place[1]:.1f}")
        return {
            "metas": {
                "location": self._location,
                "description": self._description if self._description is not None else text_of(request.prompts[0]),
                "ego_pos": pose.tolist(),
                "accel": [0.0, 0.0, _GRAVITY],
                "rotation_rate": [0.0, 0.0, 0.0],
                "vel": [0.0, 0.0, 0.0],
            },
            "gt_bboxes_3d": boxes,
            "gt_labels_3d": labels,
            "gt_vecs_label": lines[0],
            "gt_lines_instance": lines[1],
            "relative_pose": (np.linalg.inv(pose) @ last).tolist(),
            "drivable_mask": drivable.astype(int).tolist(),
            "agent_command": COMMANDS["straight"],  # for an agent that the dreamer asks itself
        }


def label_of(actor: RequestActor) -> int | None:
    """Return the number of an actor's class; ``None`` if the dreamer has none."""
    category = actor.category.lower()
    name = next((label for word, label in WORDS.items() if word in category), CLASSES.get(actor.class_name))
    return None if name is None else LABELS.index(name)


def boxes_of(actors: Sequence[RequestActor], pose: npt.NDArray[np.float64], unsent: Counter[str]) -> tuple[list[list[float]], list[int]]:
    """Return the boxes of actors within 50 m and their labels; counts categories without a label in ``unsent``.

    A box is its center, width, length, height, yaw and a velocity of 0, in the LiDAR frame of nuScenes; the yaw is clockwise
    from the direction to the back, as in mmdetection3d before 1.0.
    """
    boxes, labels = [], []
    lidar_from_global = LIDAR_FROM_EGO @ np.linalg.inv(pose)
    for actor in actors:
        box = lidar_from_global @ actor.global_from_box
        right, forward, up = box[:3, 3].tolist()
        if max(abs(right), abs(forward)) > REACH_M:
            continue
        label = label_of(actor)
        if label is None:
            if not unsent[actor.category]:
                print(f"pskel.drivearena: actors of {actor.category} have no class of the world dreamer and are left out", file=sys.stderr)
            unsent[actor.category] += 1
            continue
        length, width, height = actor.size
        yaw = math.remainder(-math.atan2(box[1, 0], box[0, 0]) - math.pi / 2, math.tau)
        boxes.append([right, forward, up, width, length, height, yaw, 0.0, 0.0])
        labels.append(label)
    return boxes, labels


def text_of(prompt: str | list[str]) -> str:
    """Return the description of a frame: the dreamer takes one for all cameras."""
    texts = {prompt} if isinstance(prompt, str) else set(prompt)
    if len(texts) != 1:
        raise ValueError(f"expected one text for all cameras, found {len(texts)} captions: use --description")
    return texts.pop()


def images_of(answer: Any) -> npt.NDArray[np.uint8]:
    """Return the images of an answer, ``[6, 224, 400, 3]``: a PNG of all six, one below the other."""
    from PIL import Image

    if answer.content_type != "image/png":
        raise ValueError(f"expected a PNG of the world dreamer, found {answer.content_type}: {answer.content[:100]!r}")
    width, height = SIZE[1], SIZE[0] * len(CAMERAS)
    try:
        with Image.open(io.BytesIO(answer.content), formats=["PNG"]) as image:
            size = image.size
            pixels = np.asarray(image.convert("RGB")) if size == (width, height) else None
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"expected a PNG of the world dreamer, found {error}") from None
    if pixels is None:
        raise ValueError(f"expected images of the world dreamer of {height}x{width} in all, found {size[1]}x{size[0]}")
    return pixels.reshape(len(CAMERAS), *SIZE, 3)
