"""Server of the denoiser protocol, version 1 (docs/src/reference/denoiser.md)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from io import BufferedIOBase
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from . import _messages as messages
from ._condition import LAYOUT_CHANNELS, FrameCondition
from ._messages import Message
from ._rig import Rig

__all__ = ["Hello", "Sampling", "WindowDenoiser", "serve"]

_PROTOCOL = {"protocol": "pskel-denoiser", "version": "1"}
_TENSORS = ("latents", "timesteps", "sigmas", "points", "layout", "action", "cameras")
_Array = np.ndarray[Any, np.dtype[np.float32]]


class Sampling(NamedTuple):
    """Sampler that a network can answer."""

    option: str
    """Value of ``--sampler``."""
    sampler: str
    prediction: str


class WindowDenoiser(Protocol):
    """Denoiser and codec for the windows of a log; see ``pskel.models.pas.Denoiser``."""

    def latent_shape(self, size: Sequence[int]) -> tuple[int, int, int, int]: ...

    def __call__(
        self,
        latents: npt.ArrayLike,
        timesteps: npt.ArrayLike,
        sigmas: npt.ArrayLike,
        conditions: Sequence[FrameCondition],
    ) -> _Array: ...

    def predict_guided(
        self,
        latents: npt.ArrayLike,
        timesteps: npt.ArrayLike,
        conditions: Sequence[FrameCondition],
        dropped: Sequence[str],
    ) -> tuple[_Array, _Array]: ...

    def encode(self, images: npt.ArrayLike) -> _Array: ...

    def decode(self, latents: npt.ArrayLike) -> _Array: ...


class Hello(NamedTuple):
    """Announcement of the generator."""

    window: int
    size: tuple[int, int]
    """Height and width of the conditions and images."""
    rig: Rig

    @classmethod
    def parse(cls, texts: Mapping[str, str], expected: Sampling) -> Hello:
        """Convert the texts of the first message; raises ``ValueError``, which names a missing or wrong text."""
        found = {name: texts.get(name) for name in _PROTOCOL}
        if found != _PROTOCOL:
            name, version = found["protocol"], found["version"]
            raise ValueError(f"expected protocol pskel-denoiser of version 1, found {name} of version {version}")
        sampler, prediction = _text(texts, "sampler"), _text(texts, "prediction")
        if (sampler, prediction) != (expected.sampler, expected.prediction):
            raise ValueError(f"expected --sampler {expected.option}, found {sampler} with prediction {prediction}")
        window, views = _whole(texts, "window"), _whole(texts, "views")
        if window < 2:
            raise ValueError(f"expected a window of at least 2 frames, found {window}")
        size = _text(texts, "condition_size").split(",")
        if len(size) != 2 or not all(side.isdecimal() for side in size):
            raise ValueError(f"expected condition_size H,W in the hello, found {texts['condition_size']!r}")
        names = _list(texts, "cameras")
        if len(names) != views or not all(isinstance(name, str) for name in names):
            raise ValueError(
                f"expected cameras as a list of {views} names in the hello, found {texts['cameras'][:200]}"
            )
        sizes = _list(texts, "image_sizes")
        if len(sizes) != views or not all(_is_size(size) for size in sizes):
            shown = texts["image_sizes"][:200]
            raise ValueError(f"expected image_sizes as a list of {views} [width, height] in the hello, found {shown}")
        try:
            fps = float(_text(texts, "fps"))
        except ValueError:
            raise ValueError(f"expected fps as a number in the hello, found {_text(texts, 'fps')!r}") from None
        rig = Rig(tuple(names), tuple((width, height) for width, height in sizes), fps)
        return cls(window, (int(size[0]), int(size[1])), rig)


def serve(
    source: BufferedIOBase, out: BufferedIOBase, expected: Sampling, create: Callable[[Hello], WindowDenoiser]
) -> None:
    """Answer the messages of a generator until it closes the stream.

    ``create`` makes the denoiser, after the hello. Raises ``ValueError`` for messages and requests that the network
    cannot answer.
    """
    first = messages.read(source)
    if first is None:
        return
    hello = Hello.parse(first.texts, expected)
    denoiser = create(hello)
    shape = denoiser.latent_shape(hello.size)
    answer = {"latent_shape": _joined(shape), "dtype": "F32", "image_size": _joined(hello.size), "guidance": "true"}
    messages.write(out, {**_PROTOCOL, **answer}, {})
    while (message := messages.read(source)) is not None:
        messages.write(out, *_answered(denoiser, hello, message))


def _answered(denoiser: WindowDenoiser, hello: Hello, message: Message) -> tuple[dict[str, str], dict[str, _Array]]:
    """Texts and tensors of the answer to a request."""
    texts, tensors = message
    shape = denoiser.latent_shape(hello.size)
    ask = texts.get("ask")
    if ask == "predict":
        conditions = _conditions(hello, shape, message)
        call = {name: texts[name] for name in ("call",) if name in texts}
        if "dropped" in texts:
            dropped = _list(texts, "dropped", "the call")
            if not all(isinstance(part, str) for part in dropped):
                raise ValueError(f"expected dropped as a list of texts in the call, found {texts['dropped'][:200]}")
            both = denoiser.predict_guided(tensors["latents"], tensors["timesteps"], conditions, dropped)
            return call, dict(zip(("prediction", "unconditional"), both))
        return call, {"prediction": denoiser(tensors["latents"], tensors["timesteps"], tensors["sigmas"], conditions)}
    if ask == "encode":
        _expect_shape(tensors, "images", (shape[0], 3, *hello.size))
        return {}, {"latents": denoiser.encode(tensors["images"])}
    if ask == "decode":
        _expect_shape(tensors, "latents", shape)
        return {}, {"images": denoiser.decode(tensors["latents"])}
    raise ValueError(f"expected ask of predict, encode or decode, found {ask}")


def _conditions(hello: Hello, shape: tuple[int, ...], message: Message) -> list[FrameCondition]:
    texts, tensors = message
    frames, views = hello.window, shape[0]
    leading = frames, views
    shapes = (
        (frames, *shape),
        (frames,),
        (frames,),
        (*leading, 20, *hello.size),
        (*leading, LAYOUT_CHANNELS, *hello.size),
        (frames, 3),
        (*leading, 16),
    )
    for name, expected in zip(_TENSORS, shapes):
        _expect_shape(tensors, name, expected)
    prompts = _list(texts, "prompts", "the call")
    if len(prompts) != frames or not all(_is_prompt(prompt, views) for prompt in prompts):
        kinds = f"prompts as a list of {frames} texts, or of lists of {views} texts"
        raise ValueError(f"expected {kinds}, in the call, found {texts['prompts'][:200]}")
    references = _list(texts, "references", "the call") if "references" in texts else [False] * frames
    if len(references) != frames or not all(isinstance(reference, bool) for reference in references):
        raise ValueError(
            f"expected references as a list of {frames} booleans in the call, found {texts['references'][:200]}"
        )
    arrays = (tensors[name] for name in ("points", "layout", "action", "cameras"))
    return [FrameCondition.create(*frame) for frame in zip(*arrays, prompts, references)]


def _text(texts: Mapping[str, str], name: str, where: str = "the hello") -> str:
    if name not in texts:
        raise ValueError(f"expected the text {name} in {where}, found none (is pskel older than this package?)")
    return texts[name]


def _whole(texts: Mapping[str, str], name: str) -> int:
    text = _text(texts, name)
    if not text.isdecimal():
        raise ValueError(f"expected {name} as a whole number in the hello, found {text!r}")
    return int(text)


def _list(texts: Mapping[str, str], name: str, where: str = "the hello") -> list[Any]:
    text = _text(texts, name, where)
    try:
        values = json.loads(text)
    except ValueError:
        values = None
    if not isinstance(values, list):
        raise ValueError(f"expected {name} as a list in {where}, found {text[:200]}")
    return values


def _is_size(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(type(side) is int and side > 0 for side in value)


def _is_prompt(value: Any, views: int) -> bool:
    """Whether a value is a text for all cameras, or one for each."""
    is_list = isinstance(value, list) and len(value) == views and all(isinstance(text, str) for text in value)
    return isinstance(value, str) or is_list


def _joined(numbers: tuple[int, ...]) -> str:
    return ",".join(map(str, numbers))


def _expect_shape(tensors: Mapping[str, _Array], name: str, shape: tuple[int, ...]) -> None:
    if name not in tensors or tensors[name].shape != shape:
        found = str(list(tensors[name].shape)) if name in tensors else "none"
        raise ValueError(f"expected the tensor {name} of {list(shape)}, found {found}")
