"""Conditions by number of the denoiser protocol, against those that each call has."""

import json
from typing import Any

import numpy as np
import pytest
from pskel.models._condition import DROPPED_MOTION, NO_COLOR, NO_DEPTH, FrameCondition
from pskel.models._sent import SentFrames

V, H, W = 2, 4, 6
BINS = 256
Tensors = dict[str, np.ndarray[Any, Any]]


def values() -> np.ndarray[Any, Any]:
    """Depth channels of each bin; only the first one is used by the networks."""
    table = np.random.default_rng(1).normal(size=(17, BINS + 1)).astype(np.float32)
    table[0] = np.concatenate([[-1], np.minimum(np.arange(1, BINS + 1), BINS - 1) / np.float32(BINS - 1)])
    return table


def compact(*seeds: int) -> Tensors:
    """The tensors of new frames."""
    made = []
    for seed in seeds:
        random = np.random.default_rng(seed)
        rgb = {name: random.integers(0, 256, (V, H, W, 3), np.uint8) for name in ("color", "boxes", "map")}
        bins = random.integers(0, BINS + 1, (V, H, W), np.uint16)
        numbers = {"action": random.normal(size=3).astype(np.float32), "cameras": random.normal(size=(V, 16)).astype(np.float32)}
        made.append({**rgb, "bins": bins, **numbers})
    return {**{name: np.stack([frame[name] for frame in made]) for name in made[0]}, "depth_values": values()}


def whole(seed: int) -> FrameCondition:
    """The same frame by the tensors of a call that has all."""
    frame = {name: tensor[0] for name, tensor in compact(seed).items() if name != "depth_values"}
    points = np.zeros((V, 20, H, W), np.float32)
    points[:, :3] = (frame["color"] / np.float32(255)).transpose(0, 3, 1, 2)
    points[:, 3:] = values()[:, frame["bins"]].transpose(1, 0, 2, 3)
    layout = np.concatenate([frame["boxes"], frame["map"]], axis=-1) / np.float32(255)
    return FrameCondition.create(points, layout.transpose(0, 3, 1, 2), frame["action"], frame["cameras"])


def texts(frames: list[int], new: list[int], without: str = "[]") -> dict[str, str]:
    return {"frames": json.dumps(frames), "new": json.dumps(new), "without": without}


def assert_same(found: FrameCondition, expected: FrameCondition) -> None:
    for name in ("points", "layout"):
        np.testing.assert_array_equal(getattr(found, name).array, getattr(expected, name).array)
    np.testing.assert_array_equal(found.action, expected.action)
    np.testing.assert_array_equal(found.cameras, expected.cameras)


def test_frames_are_those_of_whole_calls_and_kept_for_a_call() -> None:
    sent = SentFrames(V, (H, W))
    first = sent.window(texts([0, 0, 1], [0, 1]), compact(10, 11), 3)
    for found, seed in zip(first, (10, 10, 11), strict=True):
        assert_same(found, whole(seed))
    again = sent.window(texts([0, 0, 1], []), {}, 3)
    assert [id(frame) for frame in again] == [id(frame) for frame in first]
    moved = sent.window(texts([1, 2, 2], [2]), compact(12), 3)
    assert moved[0] is first[2]
    assert_same(moved[1], whole(12))
    with pytest.raises(ValueError, match="expected frames that were sent, found the numbers 0"):
        sent.window(texts([0, 1, 2], []), {}, 3)


def test_dropped_conditions_are_dropped_in_new_frames() -> None:
    sent = SentFrames(V, (H, W))
    (frame,) = sent.window(texts([7], [7], '["color", "depth", "layout", "action"]'), compact(10), 1)
    assert (frame.points.array[:, :3] == np.float32(NO_COLOR)).all() and (frame.points.array[:, 3:] == NO_DEPTH).all()
    assert (frame.layout.array == np.float32(NO_COLOR)).all() and (frame.action == DROPPED_MOTION).all()


@pytest.mark.parametrize(
    ("changed_texts", "changed_tensors", "expected"),
    [
        ({"frames": "[0]"}, {}, r"expected frames as a list of 2 numbers in the call, found \[0\]"),
        ({"frames": "[0, -1]"}, {}, r"expected frames as a list of numbers in the call, found \[0, -1\]"),
        ({"new": "0"}, {}, "expected new as a list in the call, found 0"),
        ({"without": "[1]"}, {}, r"expected without as a list of texts in the call, found \[1\]"),
        ({"without": '["sound"]'}, {}, "expected parts of layout, action, color, depth, found sound"),
        ({}, {"color": None}, r"expected the tensor color uint8 \[2, 2, 4, 6, 3\] in the call, found none"),
        ({}, {"bins": np.zeros((2, V, H, W), np.uint8)}, r"expected the tensor bins uint16 \[2, 2, 4, 6\] in the call, found uint8"),
        ({}, {"bins": np.full((2, V, H, W), BINS + 1, np.uint16)}, "expected bins below 257 in the call, found 257"),
        ({}, {"depth_values": np.zeros((4, 9), np.float32)}, r"expected the tensor depth_values float32 \[17, bins \+ 1\], found"),
    ],
)
def test_wrong_calls_are_refused(changed_texts: dict[str, str], changed_tensors: dict[str, Any], expected: str) -> None:
    tensors = {**compact(10, 11), **changed_tensors}
    given = {name: tensor for name, tensor in tensors.items() if tensor is not None}
    with pytest.raises(ValueError, match=expected):
        SentFrames(V, (H, W)).window({**texts([0, 1], [0, 1]), **changed_texts}, given, 2)
