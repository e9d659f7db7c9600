"""The side of ``pskel`` in the image protocol, written from its page, with the safetensors package."""

import io
import json
import socket
import struct
from typing import Any, BinaryIO

import numpy as np
from safetensors.numpy import load, save

Texts = dict[str, str]
Tensors = dict[str, np.ndarray[Any, Any]]

CAMERAS = ["CAM_FRONT", "CAM_BACK"]
H, W, V = 4, 6, 2
HELLO = {
    "protocol": "pskel-images",
    "version": "1",
    "log": "scene-0061",
    "seed": "3",
    "fps": "5",
    "condition_size": f"{H},{W}",
    "cameras": json.dumps(CAMERAS),
    "image_sizes": "[[1600, 900], [800, 450]]",
    "maps": '["color", "depth", "class", "instance", "boxes", "map", "later"]',
}
ACTOR = {"track": "a", "category": "vehicle.car", "class": "motor_vehicle", "size": [4.5, 1.9, 1.6], "global_from_box": [*range(16)]}


def pack(texts: Texts, tensors: Tensors) -> bytes:
    content = save({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}, texts)
    return struct.pack("<Q", len(content)) + content


def unpack(stream: BinaryIO) -> tuple[Texts, Tensors] | None:
    """Read a message; ``None`` at the end."""
    if not (prefix := stream.read(8)):
        return None
    content = stream.read(*struct.unpack("<Q", prefix))
    (length,) = struct.unpack_from("<Q", content)
    return json.loads(content[8 : 8 + length]).get("__metadata__", {}), load(content)


def request(frame: int, frames: int = 1, earlier: int = 0, size: tuple[int, int] = (H, W)) -> tuple[Texts, Tensors]:
    """A request whose arrays have values of their own."""
    random = np.random.default_rng(frame)
    pixels = (frames, V, H, W)
    texts = {
        "ask": "generate",
        "frame": str(frame),
        "t_us": json.dumps([1_600_000_000_000_000 + frame * 200_000 + n for n in range(frames)]),
        "prompts": json.dumps(["rain", ["front", "back"]][:frames]),
        "actors": json.dumps([[{**ACTOR, "track": f"{n}.{i}"} for i in range(n + 1)] for n in range(frames)]),
    }
    tensors: Tensors = {name: random.integers(0, 256, (*pixels, 3), np.uint8) for name in ("color", "boxes", "map")}
    tensors["depth"] = random.uniform(1, 90, pixels).astype(np.float32)
    tensors["depth"][..., 0, 0] = -300.0
    tensors["class"] = random.integers(0, 5, pixels, np.uint8)
    tensors["instance"] = random.integers(0, 2, pixels, np.uint16)
    tensors["global_from_ego"] = random.normal(size=(frames, 4, 4)) * 1e6
    tensors["ego_from_camera"] = random.normal(size=(frames, V, 4, 4))
    tensors["intrinsics"] = random.normal(size=(frames, V, 3, 3))
    if earlier:
        tensors["images"] = random.integers(0, 256, (earlier, V, *size, 3), np.uint8)
    return texts, tensors


class Client:
    """A connection to a generator."""

    def __init__(self, source: BinaryIO, out: BinaryIO) -> None:
        self.source, self.out = source, out

    @classmethod
    def connect(cls, address: str | tuple[str, int]) -> "Client":
        peer = socket.socket(socket.AF_UNIX if isinstance(address, str) else socket.AF_INET)
        peer.settimeout(60)
        peer.connect(address)
        stream = peer.makefile("rwb")
        peer.close()
        return cls(stream, stream)

    def ask(self, texts: Texts, tensors: Tensors | None = None) -> tuple[Texts, Tensors]:
        """Send a message, and return the answer."""
        self.out.write(pack(texts, tensors or {}))
        self.out.flush()
        answer = unpack(self.source)
        assert answer is not None, "no answer"
        return answer

    def close(self) -> None:
        self.out.close()


def answers(written: io.BytesIO) -> list[tuple[Texts, Tensors]]:
    """All messages that a generator has written."""
    written.seek(0)
    return list(iter(lambda: unpack(written), None))
