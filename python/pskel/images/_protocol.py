"""The hello and the requests of the image protocol, version 1."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .. import _texts as texts_of
from .._messages import Message
from ._generator import MAPS, ImageRequest, RequestActor, Settings

__all__ = ["PROTOCOL", "Hello", "answer_of", "request_of"]

PROTOCOL = {"protocol": "pskel-images", "version": "1"}
#: Depth of an empty pixel in messages, meters.
EMPTY_DEPTH_M = -300.0
#: Type of each map, and its axes after N, V, H, W.
_MAPS: dict[str, tuple[Any, tuple[int, ...]]] = {
    "color": (np.uint8, (3,)),
    "boxes": (np.uint8, (3,)),
    "map": (np.uint8, (3,)),
    "depth": (np.float32, ()),
    "class": (np.uint8, ()),
    "instance": (np.uint16, ()),
}


class Hello(NamedTuple):
    """Announcement of ``pskel``, before the first request."""

    log: str
    """Name of the log."""
    seed: int
    """``--noise-seed``."""
    fps: float
    """Planning steps per second."""
    condition_size: tuple[int, int]
    """Height and width of the maps, pixels."""
    cameras: tuple[str, ...]
    """Names of the V cameras, in the order of all arrays."""
    image_sizes: tuple[tuple[int, int], ...]
    """Width and height of the recorded images of each camera, pixels."""
    maps: tuple[str, ...]
    """The maps that a generator can ask for."""

    @classmethod
    def parse(cls, texts: Mapping[str, str]) -> Hello:
        """Convert the texts of the first message; raises ``ValueError``, which names a missing or wrong text."""
        found = {name: texts.get(name) for name in PROTOCOL}
        if found != PROTOCOL:
            name, version = found["protocol"], found["version"]
            raise ValueError(f"expected protocol pskel-images of version 1, found {name} of version {version}")
        cameras = _names(texts, "cameras")
        sizes = texts_of.listed(texts, "image_sizes")
        if len(sizes) != len(cameras) or not all(texts_of.is_size(size) for size in sizes):
            shown = texts["image_sizes"][:200]
            raise ValueError(f"expected image_sizes as a list of {len(cameras)} [width, height] in the hello, found {shown}")
        return cls(
            log=texts_of.text(texts, "log"),
            seed=texts_of.whole(texts, "seed"),
            fps=texts_of.number(texts, "fps"),
            condition_size=texts_of.pair(texts, "condition_size"),
            cameras=cameras,
            image_sizes=tuple((width, height) for width, height in sizes),
            # Maps of later versions are left out: no generator asks for them.
            maps=tuple(name for name in _names(texts, "maps") if name in MAPS),
        )


def answer_of(settings: Settings) -> dict[str, str]:
    """Texts of the answer to the hello."""
    return {
        **PROTOCOL,
        "image_size": texts_of.joined(settings.size),
        "maps": json.dumps(settings.maps),
        "references": str(settings.references),
        "history": str(settings.history),
        "forecasts": str(settings.forecasts),
    }


def request_of(message: Message, hello: Hello, settings: Settings) -> ImageRequest:
    """Convert a request; raises ``ValueError``, which names a missing or wrong text or tensor."""
    texts, tensors = message
    where, views = "the request", len(hello.cameras)
    if (ask := texts.get("ask")) != "generate":
        raise ValueError(f"expected ask of generate in {where}, found {ask}")
    frame = texts_of.whole(texts, "frame", where)
    if frame < settings.references:
        raise ValueError(f"expected a frame of at least {settings.references}, the number of references, in {where}, found {frame}")
    t_us = texts_of.listed(texts, "t_us", where)
    frames = len(t_us)
    if not 1 <= frames <= 1 + settings.forecasts:
        raise ValueError(f"expected t_us of 1 to {1 + settings.forecasts} frames in {where}, found {frames}")
    prompts, actors = (_each_frame(texts, name, frames) for name in ("prompts", "actors"))
    if not all(type(time) is int for time in t_us):
        raise ValueError(f"expected t_us as a list of whole numbers in {where}, found {texts['t_us'][:200]}")
    if not all(_is_prompt(prompt, views) for prompt in prompts):
        raise ValueError(f"expected prompts as texts, or as lists of {views} texts, in {where}, found {texts['prompts'][:200]}")
    maps = {}
    for name in settings.maps:
        kind, last = _MAPS[name]
        maps[name] = _tensor(tensors, name, kind, (frames, views, *hello.condition_size, *last))
    if "depth" in maps:
        maps["depth"][maps["depth"] == EMPTY_DEPTH_M] = np.inf
    known = min(settings.history, frame)
    shape = (known, views, *settings.size, 3)
    request = ImageRequest(
        frame=frame,
        t_us=t_us,
        prompts=prompts,
        actors=[[_actor(actor) for actor in _actors(found)] for found in actors],
        maps=maps,
        global_from_ego=_finite(tensors, "global_from_ego", (frames, 4, 4)),
        ego_from_camera=_finite(tensors, "ego_from_camera", (frames, views, 4, 4)),
        intrinsics=_finite(tensors, "intrinsics", (frames, views, 3, 3)),
        images=_tensor(tensors, "images", np.uint8, shape) if known else np.zeros(shape, np.uint8),
        cameras=hello.cameras,
    )
    check_values(request)
    return request


def check_values(request: ImageRequest) -> None:
    """Raise ``ValueError`` for depths that are not positive, and for instances without an actor."""
    depth, instance = request.maps.get("depth"), request.maps.get("instance")
    if depth is not None and not (depth > 0.0).all():
        raise ValueError(f"expected depths above 0 m in the request, found {depth[~(depth > 0.0)][0]}")
    for numbers, actors in zip(instance if instance is not None else (), request.actors):
        if (greatest := numbers.max(initial=0)) > len(actors):
            raise ValueError(f"expected instances of {len(actors)} actors in the request, found {greatest}")


def _names(texts: Mapping[str, str], name: str) -> tuple[str, ...]:
    names = texts_of.listed(texts, name)
    if not names or not all(isinstance(entry, str) for entry in names) or len(set(names)) < len(names):
        raise ValueError(f"expected {name} as a list of different names in the hello, found {texts[name][:200]}")
    return tuple(names)


def _each_frame(texts: Mapping[str, str], name: str, frames: int) -> list[Any]:
    values = texts_of.listed(texts, name, "the request")
    if len(values) != frames:
        raise ValueError(f"expected {name} of {frames} frames in the request, found {len(values)}")
    return values


def _is_prompt(value: Any, views: int) -> bool:
    each = value if isinstance(value, list) else [value] * views
    return len(each) == views and all(isinstance(entry, str) for entry in each)


def _actors(found: Any) -> list[Any]:
    if not isinstance(found, list):
        raise ValueError(f"expected actors as lists in the request, found {json.dumps(found)[:200]}")
    return found


def _actor(found: Any) -> RequestActor:
    actor: dict[str, Any] = found if isinstance(found, dict) else {}
    names: list[Any] = [actor.get(name) for name in ("track", "category", "class")]
    size: Any = actor.get("size")
    pose: Any = actor.get("global_from_box")
    if not all(isinstance(name, str) for name in names) or not _are_numbers(size, 3) or not _are_numbers(pose, 16):
        expected = "expected an actor with track, category, class, 3 numbers of size and 16 of global_from_box in the request"
        raise ValueError(f"{expected}, found {json.dumps(found)[:200]}")
    track, category, class_name = names
    length, width, height = map(float, size)
    return RequestActor(track, category, class_name, (length, width, height), np.array(pose, np.float64).reshape(4, 4))


def _are_numbers(values: Any, count: int) -> bool:
    if not isinstance(values, list) or len(values) != count:
        return False
    return all(type(value) in (int, float) for value in values) and bool(np.isfinite(np.array(values, np.float64)).all())


def _tensor(tensors: Mapping[str, npt.NDArray[Any]], name: str, kind: Any, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    found = tensors.get(name)
    if found is None or found.dtype != kind or found.shape != shape:
        shown = "none" if found is None else f"{found.dtype} {list(found.shape)}"
        raise ValueError(f"expected the tensor {name} {np.dtype(kind)} {list(shape)} in the request, found {shown}")
    return found


def _finite(tensors: Mapping[str, npt.NDArray[Any]], name: str, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    found = _tensor(tensors, name, np.float64, shape)
    if not np.isfinite(found).all():
        raise ValueError(f"expected the tensor {name} of finite numbers in the request, found {found[~np.isfinite(found)][0]}")
    return found
