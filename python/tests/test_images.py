"""The image protocol against a client of its own."""

import io
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest
from pskel import _messages as messages
from pskel import images

pytest.importorskip("safetensors")
from images_client import CAMERAS, HELLO, H, V, W, Client, answers, pack, request

TESTS = Path(__file__).parent
TYPES = "expected a message of safetensors with tensors of U8, U16, F32, F64, found"


class Recorder(pskel.ImageGenerator):
    """Keeps its requests, and returns an image that is given, by default a gray one."""

    image_size = (H, W)
    maps = ("color", "depth", "class", "instance", "boxes", "map")
    references = 2
    history = 3
    forecasts = 1

    def __init__(self, image: Any = None) -> None:
        self.image = np.full((V, H, W, 3), 128, np.uint8) if image is None else image
        self.requests: list[pskel.ImageRequest] = []

    def generate(self, request: pskel.ImageRequest) -> Any:
        self.requests.append(request)
        return self.image


def converse(generator: Any, *sent: bytes) -> list[Any]:
    """The answers of a generator to messages, and the exception that it raised, if any."""
    from pskel.images import _server as server

    out = io.BytesIO()
    hellos: list[images.Hello] = []

    def create(hello: images.Hello) -> pskel.ImageGenerator:
        hellos.append(hello)
        return generator

    try:
        server._converse(create, server._Connection(io.BytesIO(b"".join(sent)), out))
    except Exception as error:
        return [*answers(out), error]
    return [hellos, *answers(out)]


def test_requests_and_answers() -> None:
    generator = Recorder(np.arange(V * H * W * 3, dtype=np.uint8).reshape(V, H, W, 3))
    texts, tensors = request(5, frames=2, earlier=3)
    (hello,), said, (answer, made) = converse(generator, pack(HELLO, {}), pack(texts, tensors))
    assert hello == images.Hello(
        log="scene-0061", seed=3, fps=5.0, condition_size=(H, W), cameras=tuple(CAMERAS),
        image_sizes=((1600, 900), (800, 450)), maps=("color", "depth", "class", "instance", "boxes", "map"),
    )  # fmt: skip
    assert said == (
        {
            "protocol": "pskel-images", "version": "1", "image_size": "4,6", "references": "2", "history": "3", "forecasts": "1",
            "maps": '["color", "depth", "class", "instance", "boxes", "map"]',
        },
        {},
    )  # fmt: skip
    assert answer == {"frame": "5"} and made.keys() == {"images"} and made["images"].dtype == np.uint8
    np.testing.assert_array_equal(made["images"], generator.image)
    (seen,) = generator.requests
    assert (seen.frame, seen.t_us, seen.prompts) == (5, [1_600_000_001_000_000, 1_600_000_001_000_001], ["rain", ["front", "back"]])
    assert seen.cameras == tuple(CAMERAS) and [len(actors) for actors in seen.actors] == [1, 2]
    actor = seen.actors[1][1]
    assert actor[:4] == ("1.1", "vehicle.car", "motor_vehicle", (4.5, 1.9, 1.6))
    np.testing.assert_array_equal(actor.global_from_box, np.arange(16.0).reshape(4, 4))
    for name in generator.maps:
        expected = np.where(tensors[name] == -300.0, np.inf, tensors[name]) if name == "depth" else tensors[name]
        np.testing.assert_array_equal(seen.maps[name], expected)
        assert seen.maps[name].dtype == tensors[name].dtype
    assert np.isinf(seen.maps["depth"]).sum() == 2 * V
    for name in ("global_from_ego", "ego_from_camera", "intrinsics", "images"):
        np.testing.assert_array_equal(getattr(seen, name), tensors[name])


def test_defaults_and_the_first_requests() -> None:
    class Plain(pskel.ImageGenerator):
        image_size = (2, 3)
        history = 0

        def generate(self, request: pskel.ImageRequest) -> Any:
            assert request.images.shape == (0, V, 2, 3, 3) and request.maps.keys() == {"color"}
            return np.zeros((V, 2, 3, 3), np.uint8)

    _, (said, _), (answer, _) = converse(Plain(), pack(HELLO, {}), pack(*request(1)))
    assert said["maps"] == '["color"]' and (said["references"], said["history"], said["forecasts"]) == ("1", "0", "0")
    assert answer == {"frame": "1"}
    generator = Recorder()  # frame 2 has 2 of 3 earlier images
    converse(generator, pack(HELLO, {}), pack(*request(2, frames=2, earlier=2)))
    assert generator.requests[0].images.shape == (2, V, H, W, 3)
    generator = Recorder()  # at the end of a log there are fewer forecasts
    converse(generator, pack(HELLO, {}), pack(*request(5, frames=1, earlier=3)))
    assert generator.requests[0].maps["color"].shape == (1, V, H, W, 3)
    assert converse(Recorder()) == [[]]


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"protocol": "pskel-denoiser"}, "expected protocol pskel-images of version 1, found pskel-denoiser of version 1"),
        ({"version": "2"}, "expected protocol pskel-images of version 1, found pskel-images of version 2"),
        ({"fps": "nan"}, "expected fps as a number in the hello, found 'nan'"),
        ({"seed": "-1"}, "expected seed as a whole number in the hello, found '-1'"),
        ({"condition_size": "4x6"}, "expected condition_size H,W in the hello, found '4x6'"),
        ({"cameras": '["A", "A"]'}, 'expected cameras as a list of different names in the hello, found ["A", "A"]'),
        ({"cameras": "[]"}, "expected cameras as a list of different names in the hello, found []"),
        ({"image_sizes": "[[1600, 900]]"}, "expected image_sizes as a list of 2 [width, height] in the hello, found [[1600, 900]]"),
        ({"maps": '["color"]'}, "expected maps of a generator among color, found color, depth, class, instance, boxes, map"),
    ],
)
def test_wrong_hellos(changed: dict[str, str], expected: str) -> None:
    ((texts, _), error) = converse(Recorder(), pack({**HELLO, **changed}, {}))
    assert texts == {"error": expected} and str(error) == expected


def test_a_missing_text_is_named() -> None:
    for name in set(HELLO) - {"protocol", "version"}:
        ((texts, _), _) = converse(Recorder(), pack({key: text for key, text in HELLO.items() if key != name}, {}))
        assert texts["error"] == f"expected the text {name} in the hello, found none (is pskel older than this package?)"


ONE_FRAME = {"track": "a", "category": "c", "class": "object", "size": [1, 1, 1], "global_from_box": [0] * 16}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"ask": "predict"}, "expected ask of generate in the request, found predict"),
        ({"frame": "1"}, "expected a frame of at least 2, the number of references, in the request, found 1"),
        ({"t_us": "[]"}, "expected t_us of 1 to 2 frames in the request, found 0"),
        ({"t_us": "[1, 2, 3]"}, "expected t_us of 1 to 2 frames in the request, found 3"),
        ({"prompts": '[""]'}, "expected prompts of 2 frames in the request, found 1"),
        ({"t_us": "[1, 2.5]"}, "expected t_us as a list of whole numbers in the request, found [1, 2.5]"),
        ({"prompts": '["", ["a"]]'}, 'expected prompts as texts, or as lists of 2 texts, in the request, found ["", ["a"]]'),
        ({"actors": "[[], {}]"}, "expected actors as lists in the request, found {}"),
        ({"actors": json.dumps([[{**ONE_FRAME, "size": [1, 1]}], []])}, "expected an actor with track, category, class, 3 numbers of size"),
        ({"actors": json.dumps([[{**ONE_FRAME, "global_from_box": [float("nan")] * 16}], []])}, "expected an actor with track"),
        ({"actors": "[[], []]"}, "expected instances of 0 actors in the request, found 1"),
    ],
)
def test_wrong_texts_of_requests(changed: dict[str, str], expected: str) -> None:
    texts, tensors = request(5, frames=2, earlier=3)
    (_, (answer, _), error) = converse(Recorder(), pack(HELLO, {}), pack({**texts, **changed}, tensors))
    assert answer["error"].startswith(expected) and str(error).startswith(expected)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("color", None, "expected the tensor color uint8 [2, 2, 4, 6, 3] in the request, found none"),
        ("color", np.zeros((2, 2, 4, 6, 3), np.float32), "expected the tensor color uint8 [2, 2, 4, 6, 3] in the request, found float32 [2, 2, 4, 6, 3]"),
        ("depth", np.ones((2, 2, 4, 6), np.float64), "expected the tensor depth float32 [2, 2, 4, 6] in the request, found float64 [2, 2, 4, 6]"),
        ("depth", np.full((2, 2, 4, 6), np.nan, np.float32), "expected depths above 0 m in the request, found nan"),
        ("depth", np.full((2, 2, 4, 6), -1, np.float32), "expected depths above 0 m in the request, found -1.0"),
        ("instance", np.full((2, 2, 4, 6), 2, np.uint16), "expected instances of 1 actors in the request, found 2"),
        ("global_from_ego", np.full((2, 4, 4), np.inf), "expected the tensor global_from_ego of finite numbers in the request, found inf"),
        ("intrinsics", np.zeros((2, 2, 4, 4)), "expected the tensor intrinsics float64 [2, 2, 3, 3] in the request, found float64 [2, 2, 4, 4]"),
        ("images", None, "expected the tensor images uint8 [3, 2, 4, 6, 3] in the request, found none"),
        ("images", np.zeros((2, 2, 4, 6, 3), np.uint8), "expected the tensor images uint8 [3, 2, 4, 6, 3] in the request, found uint8 [2, 2, 4, 6, 3]"),
    ],
)  # fmt: skip
def test_wrong_tensors_of_requests(name: str, value: Any, expected: str) -> None:
    texts, tensors = request(5, frames=2, earlier=3)
    changed = {key: tensor for key, tensor in {**tensors, name: value}.items() if tensor is not None}
    (_, (answer, _), error) = converse(Recorder(), pack(HELLO, {}), pack(texts, changed))
    assert answer["error"] == expected == str(error)


@pytest.mark.parametrize(
    ("image", "found"),
    [
        (np.full((V, H, W, 3), np.nan, np.float32), "float32 [2, 4, 6, 3]"),
        (np.zeros((V, 3, H, W), np.uint8), "uint8 [2, 3, 4, 6]"),
        (np.zeros((V, H, W, 3), np.int64), "int64 [2, 4, 6, 3]"),
        (None, "object []"),
        ([[1], [1, 2]], ""),
    ],
)
def test_wrong_images_of_a_generator(image: Any, found: str) -> None:
    generator = Recorder()
    generator.image = image
    (_, (answer, tensors), _) = converse(generator, pack(HELLO, {}), pack(*request(5, frames=2, earlier=3)))
    assert not tensors
    if found:
        assert answer == {"error": f"expected images uint8 [2, 4, 6, 3] of the generator, found {found}"}
    masked = Recorder(np.ma.masked_equal(np.zeros((V, H, W, 3), np.uint8), 0))
    (_, (answer, _), _) = converse(masked, pack(HELLO, {}), pack(*request(5, frames=2, earlier=3)))
    assert answer == {"error": "expected images without masked values, found a masked array"}


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("image_size", (0, 6), "expected image_size of a generator as (height, width), found (0, 6)"),
        ("image_size", None, "expected image_size of a generator as (height, width), found None"),
        ("image_size", (20000, 20000), "expected images of at most 1073741824 bytes, found 2 of 20000x20000: 2400000000 bytes"),
        ("maps", "normals", "expected maps of a generator among color, depth, class, instance, boxes, map, found normals"),
        ("maps", ["color", "color"], "expected maps of a generator among color, depth, class, instance, boxes, map, found color, color"),
        ("references", 101, "expected references of a generator as a number from 0 to 100, found 101"),
        ("history", -1, "expected history of a generator as a number from 0 to 100, found -1"),
        ("forecasts", 1.5, "expected forecasts of a generator as a number from 0 to 100, found 1.5"),
    ],
)
def test_wrong_attributes_of_a_generator(name: str, value: Any, expected: str) -> None:
    generator = Recorder()
    setattr(generator, name, value)
    ((answer, _), error) = converse(generator, pack(HELLO, {}))
    assert answer == {"error": expected} and str(error) == expected


def test_messages_are_safetensors() -> None:
    from safetensors.numpy import load

    tensors = {
        "a": np.arange(5, dtype=np.uint8),
        "b": np.arange(6, dtype=np.float64).reshape(2, 3).T,
        "c": np.zeros((0, 2), np.float32),
        "d": np.arange(3, dtype=">u2"),
        "e": np.float32(1.5).reshape(()),
    }
    stream = io.BytesIO()
    messages.write(stream, {"x": "é"}, tensors)
    found = load(stream.getvalue()[8:])
    stream.seek(0)
    for again in (messages.read(stream), messages.read(io.BytesIO(pack({"x": "é"}, {**tensors, "d": tensors["d"].astype("<u2")})))):
        assert again is not None and again.texts == {"x": "é"} and again.tensors.keys() == found.keys() == tensors.keys()
        for name, tensor in tensors.items():
            np.testing.assert_array_equal(found[name], tensor)
            np.testing.assert_array_equal(again.tensors[name], tensor)
            assert again.tensors[name].dtype == found[name].dtype and again.tensors[name].flags.writeable
    with pytest.raises(ValueError, match="expected the tensor a of U8, U16, F32, F64, found int64"):
        messages.write(stream, {}, {"a": np.zeros(1, np.int64)})


def raw(header: Any, data: bytes = b"") -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<QQ", 8 + len(text) + len(data), len(text)) + text + data


def tensor(kind: str, shape: Any, *offsets: int) -> dict[str, Any]:
    return {"dtype": kind, "shape": shape, "data_offsets": list(offsets)}


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        (b"GET / HTTP/1.1\r\n", "expected a message of at most 34359738368 bytes, found"),
        (b"\x10\0\0", "expected the length of a message in 8 bytes, found the end after 3"),
        (pack(HELLO, {})[:-3], "expected a message of "),
        (struct.pack("<QQ", 8, 1), f"{TYPES} 8 bytes: a header of 1 bytes"),
        (struct.pack("<Q", 4) + b"abcd", f"{TYPES} 4 bytes: no header"),
        (raw([]), f"{TYPES} 10 bytes: a header that is no object"),
        (raw(b"{" * 9), f"{TYPES} 17 bytes: "),
        (raw(b"[" * 100_000), TYPES),
        (raw(b'{"a": 1, "a": 2}'), f"{TYPES} 24 bytes: a key that occurs twice"),
        (raw({"__metadata__": {"a": 1}}), f"{TYPES} 34 bytes: __metadata__ that is no object of texts"),
        (raw({"a": 1}), f"{TYPES} 16 bytes: a without dtype, shape and data_offsets"),
        (raw({"a": tensor("I64", [1], 0, 8)}, bytes(8)), "I64"),
        (raw({"a": tensor("U8", [-1], 0, 8)}, bytes(8)), "a without dtype, shape and data_offsets"),
        (raw({"a": tensor("F32", [2], 0, 4)}, bytes(4)), "a of F32 [2] in 4 bytes"),
        (raw({"a": tensor("U8", [4], 0, 4)}, bytes(3)), "3 bytes of data for tensors of 4"),
        (raw({"a": tensor("U8", [4], 0, 4)}, bytes(5)), "5 bytes of data for tensors of 4"),
        (raw({"a": tensor("U8", [4], 0, 4), "b": tensor("U8", [4], 2, 6)}, bytes(6)), "b from byte 2 of the data"),
        (raw({"a": tensor("U8", [4], 1, 5)}, bytes(5)), "a from byte 1 of the data"),
    ],
)  # fmt: skip
def test_wrong_messages(sent: bytes, expected: str) -> None:
    ((answer, _), error) = converse(Recorder(), sent)
    assert expected in answer["error"] and expected in str(error) and len(answer["error"]) <= 500


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a source tree without the compiled part."""
    folder = tmp_path_factory.mktemp("sources")
    shutil.copytree(Path(pskel.__file__).parent, folder / "pskel", ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    return {**os.environ, "PYTHONPATH": str(folder)}


def run(environment: dict[str, str], *arguments: str, **options: Any) -> "subprocess.Popen[bytes]":
    command = [sys.executable, str(TESTS / "image_generators.py"), *arguments]
    return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, **options)


def expect_mean(client: Client) -> None:
    """Ask for two frames, and compare the images."""
    assert client.ask(HELLO)[0]["image_size"] == f"{H},{W}"
    for frame, earlier in ((2, 2), (4, 3)):
        texts, tensors = request(frame, 2, earlier)
        answer, made = client.ask(texts, tensors)
        assert answer == {"frame": str(frame)}
        expected = np.concatenate([tensors["color"], tensors["images"]]).mean(axis=0).astype(np.uint8)
        np.testing.assert_array_equal(made["images"], expected)


def test_a_process_without_the_compiled_part_prints(sources: dict[str, str]) -> None:
    program = run(sources, "Mean", stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert program.stdin is not None and program.stdout is not None
    client = Client(program.stdout, program.stdin)  # type: ignore[arg-type]
    expect_mean(client)
    client.close()
    out, errors = program.stdout.read(), program.stderr.read().decode()  # type: ignore[union-attr]
    assert program.wait(60) == 0 and out == b""
    assert errors.splitlines() == ["hello from Python scene-0061", "hello from another process", "frame 2", "frame 4"]


def test_an_exception_of_a_process_is_sent_and_raised(sources: dict[str, str]) -> None:
    program = run(sources, "Moody", stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    client = Client(program.stdout, program.stdin)  # type: ignore[arg-type]
    client.ask(HELLO)
    assert client.ask(*request(3, 2, 3)) == ({"error": "RuntimeError: no memory left"}, {})
    assert program.stderr is not None and "RuntimeError: no memory" in program.stderr.read().decode()
    assert program.wait(60) == 1


def test_a_process_ends_with_the_connection(sources: dict[str, str]) -> None:
    program = run(sources, "Mean", stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    program.stdout.close()  # type: ignore[union-attr]
    program.stdin.write(pack(HELLO, {}) + pack(*request(2, 2, 2)))  # type: ignore[union-attr]
    program.stdin.close()  # type: ignore[union-attr]
    assert "Traceback" not in program.stderr.read().decode()  # type: ignore[union-attr]
    assert program.wait(60) == 0


@pytest.fixture(params=["unix", "tcp"])
def listener(request: pytest.FixtureRequest, tmp_path: Path, sources: dict[str, str]) -> Iterator[Any]:
    """Address of a generator that listens."""
    if request.param == "unix":
        address: Any = str(tmp_path / "socket")
        name = f"unix:{address}"
        with socket.socket(socket.AF_UNIX) as left:  # of an earlier run
            left.bind(address)
    else:
        with socket.create_server(("127.0.0.1", 0)) as free:
            address = free.getsockname()
        name = f"tcp:127.0.0.1:{address[1]}"
    program = run(sources, "Moody", name)
    for _ in range(600):
        try:
            Client.connect(address).close()
            break
        except OSError:
            assert program.poll() is None
            time.sleep(0.1)
    yield address
    program.send_signal(signal.SIGINT)
    errors = program.stderr.read().decode()  # type: ignore[union-attr]
    program.wait(60)
    assert errors.count("RuntimeError: no memory") == 1 and errors.rstrip().endswith("KeyboardInterrupt"), errors


def test_a_socket_has_one_connection_after_another(listener: Any) -> None:
    for _ in range(2):
        client = Client.connect(listener)
        expect_mean(client)
        client.close()
    client = Client.connect(listener)
    client.ask(HELLO)
    assert client.ask(*request(3, 2, 3)) == ({"error": "RuntimeError: no memory left"}, {})
    client = Client.connect(listener)
    assert "expected ask of generate" in (client.ask(HELLO), client.ask({"ask": "no"}))[1][0]["error"]
    client = Client.connect(listener)
    client.out.write(pack(HELLO, {})[:100])  # ends within a message
    client.close()
    expect_mean(Client.connect(listener))


@pytest.mark.parametrize("address", ["unix:", "tcp:11000", "tcp:localhost:http", "http://localhost:1"])
def test_wrong_addresses(address: str) -> None:
    with pytest.raises(ValueError, match=f"expected an address unix:PATH or tcp:HOST:PORT, found {address}"):
        images.serve(lambda hello: Recorder(), address)


def test_a_file_is_not_replaced_by_a_socket(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OSError, match="in use"):
        images.serve(lambda hello: Recorder(), f"unix:{tmp_path / 'file'}")
    assert (tmp_path / "file").read_text() == "mine"
