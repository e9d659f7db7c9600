"""Server of the denoiser protocol, version 1 (docs/src/reference/denoiser.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from io import BufferedIOBase
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from .. import _messages as messages
from .._messages import Message
from .._texts import is_size, joined, listed, number, pair, text, whole
from ._condition import LAYOUT_CHANNELS, FrameCondition
from ._rig import Rig
from ._sent import TYPES, SentFrames

__all__ = ["Hello", "Sampling", "WindowDenoiser", "serve"]

_PROTOCOL = {"protocol": "pskel-denoiser", "version": "1"}
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
        sampler, prediction = text(texts, "sampler"), text(texts, "prediction")
        if (sampler, prediction) != (expected.sampler, expected.prediction):
            raise ValueError(f"expected --sampler {expected.option}, found {sampler} with prediction {prediction}")
        window, views = whole(texts, "window"), whole(texts, "views")
        if window < 2:
            raise ValueError(f"expected a window of at least 2 frames, found {window}")
        size = pair(texts, "condition_size")
        names = listed(texts, "cameras")
        if len(names) != views or not all(isinstance(name, str) for name in names):
            raise ValueError(
                f"expected cameras as a list of {views} names in the hello, found {texts['cameras'][:200]}"
            )
        sizes = listed(texts, "image_sizes")
        if len(sizes) != views or not all(is_size(size) for size in sizes):
            shown = texts["image_sizes"][:200]
            raise ValueError(f"expected image_sizes as a list of {views} [width, height] in the hello, found {shown}")
        rig = Rig(tuple(names), tuple((width, height) for width, height in sizes), number(texts, "fps"))
        return cls(window, size, rig)


def serve(
    source: BufferedIOBase, out: BufferedIOBase, expected: Sampling, create: Callable[[Hello], WindowDenoiser]
) -> None:
    """Answer the messages of a generator until it closes the stream.

    ``create`` makes the denoiser, after the hello. Raises ``ValueError`` for messages and requests that the network
    cannot answer.
    """
    first = messages.read(source, TYPES)
    if first is None:
        return
    hello = Hello.parse(first.texts, expected)
    denoiser = create(hello)
    shape = denoiser.latent_shape(hello.size)
    sent = SentFrames(shape[0], hello.size)
    answer = {"latent_shape": joined(shape), "dtype": "F32", "image_size": joined(hello.size), "guidance": "true", "frames": "true"}
    messages.write(out, {**_PROTOCOL, **answer}, {})
    while (message := messages.read(source, TYPES)) is not None:
        messages.write(out, *_answered(denoiser, hello, sent, message))


def _answered(
    denoiser: WindowDenoiser, hello: Hello, sent: SentFrames, message: Message
) -> tuple[dict[str, str], dict[str, _Array]]:
    """Texts and tensors of the answer to a request."""
    texts, tensors = message
    shape = denoiser.latent_shape(hello.size)
    ask = texts.get("ask")
    if ask == "predict":
        conditions = _conditions(hello, shape, sent, message)
        call = {name: texts[name] for name in ("call",) if name in texts}
        if "dropped" in texts:
            dropped = listed(texts, "dropped", "the call")
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


def _conditions(hello: Hello, shape: tuple[int, ...], sent: SentFrames, message: Message) -> list[FrameCondition]:
    texts, tensors = message
    frames, views = hello.window, shape[0]
    for name, expected in (("latents", (frames, *shape)), ("timesteps", (frames,)), ("sigmas", (frames,))):
        _expect_shape(tensors, name, expected)
    prompts = listed(texts, "prompts", "the call")
    if len(prompts) != frames or not all(_is_prompt(prompt, views) for prompt in prompts):
        kinds = f"prompts as a list of {frames} texts, or of lists of {views} texts"
        raise ValueError(f"expected {kinds}, in the call, found {texts['prompts'][:200]}")
    references = listed(texts, "references", "the call") if "references" in texts else [False] * frames
    if len(references) != frames or not all(isinstance(reference, bool) for reference in references):
        raise ValueError(
            f"expected references as a list of {frames} booleans in the call, found {texts['references'][:200]}"
        )
    of_frames = sent.window(texts, tensors, frames) if "frames" in texts else _whole(hello, views, tensors)
    return [frame.told(prompt, reference) for frame, prompt, reference in zip(of_frames, prompts, references)]


def _whole(hello: Hello, views: int, tensors: Mapping[str, _Array]) -> list[FrameCondition]:
    """Conditions of a call that has all of them."""
    leading = hello.window, views
    maps = {"points": (*leading, 20, *hello.size), "layout": (*leading, LAYOUT_CHANNELS, *hello.size)}
    shapes = {**maps, "action": (hello.window, 3), "cameras": (*leading, 16)}
    for name, expected in shapes.items():
        _expect_shape(tensors, name, expected)
    return [FrameCondition.create(*arrays) for arrays in zip(*(tensors[name] for name in shapes))]


def _is_prompt(value: Any, views: int) -> bool:
    """Whether a value is a text for all cameras, or one for each."""
    is_list = isinstance(value, list) and len(value) == views and all(isinstance(text, str) for text in value)
    return isinstance(value, str) or is_list


def _expect_shape(tensors: Mapping[str, _Array], name: str, shape: tuple[int, ...]) -> None:
    if name not in tensors or tensors[name].shape != shape:
        found = str(list(tensors[name].shape)) if name in tensors else "none"
        raise ValueError(f"expected the tensor {name} of {list(shape)}, found {found}")
