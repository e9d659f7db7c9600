"""Reads MCAP files with the packages `mcap` and `mcap-protobuf-support`."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

TYPES = {
    "/tf": "foxglove.FrameTransforms",
    "/actors": "foxglove.SceneUpdate",
    "/ego": "foxglove.SceneUpdate",
    "/plan": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
    "calibration": "foxglove.CameraCalibration",
}


def read(path: Path) -> tuple[dict[str, list[tuple[int, Any]]], dict[str, dict[str, str]]]:
    """The messages of each topic with their times, and the metadata records."""
    reader: Any = pytest.importorskip("mcap.reader")
    decoder: Any = pytest.importorskip("mcap_protobuf.decoder")
    topics = defaultdict(list)
    with path.open("rb") as file:
        found = reader.make_reader(file, validate_crcs=True, decoder_factories=[decoder.DecoderFactory()])
        for schema, channel, message, decoded in found.iter_decoded_messages():
            kind = TYPES.get(channel.topic) or TYPES.get(channel.topic.rsplit("/")[-1], "foxglove.CompressedImage")
            assert (schema.name, schema.encoding) == (kind, "protobuf")
            assert message.log_time == message.publish_time
            topics[channel.topic].append((message.log_time, decoded))
        metadata = {record.name: record.metadata for record in found.iter_metadata()}
        statistics = found.get_summary().statistics
    assert statistics.message_count == sum(len(messages) for messages in topics.values())
    return topics, metadata


def vector(message: Any) -> npt.NDArray[np.float64]:
    return np.array([message.x, message.y, message.z])


def matrix(rotation: Any, translation: Any) -> npt.NDArray[np.float64]:
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    result = np.eye(4)
    result[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    result[:3, 3] = vector(translation)
    return result
