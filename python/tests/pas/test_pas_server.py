"""Messages and errors of the video network's denoiser process."""

import argparse
import io as streams
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pas_base import Array, pack, unpack
from pskel import _messages as messages

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
pytest.importorskip("transformers")
from pas_frames import CAMERAS, HELLO, H, V, arguments, needs_fixture, request, window  # noqa: E402
from pskel.models.pas import Denoiser  # noqa: E402
from pskel.models.pas import __main__ as command  # noqa: E402

pytest_plugins = ["pas_frames"]
pytestmark = needs_fixture


def failure(capsys: pytest.CaptureFixture[str], arguments: list[str], *sent: bytes) -> str:
    """Error of the command, which fails after the messages ``sent``."""
    capsys.readouterr()
    options: argparse.Namespace = command.parser().parse_args(arguments)
    assert command.run(options, streams.BytesIO(b"".join(sent)), streams.BytesIO()) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = [line for line in printed.err.splitlines() if "was trained with" not in line]
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("pskel.models.pas: ")
    return lines[0].removeprefix("pskel.models.pas: ")


NO_TEXT = "found none (is pskel older than this package?)"


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"protocol": "pskel-planner"}, "expected protocol pskel-denoiser of version 1, found pskel-planner of version 1"),
        ({"version": "2"}, "expected protocol pskel-denoiser of version 1, found pskel-denoiser of version 2"),
        (
            {"sampler": "ddim", "prediction": "epsilon"},
            "expected --sampler flow_match, found ddim with prediction epsilon",
        ),
        ({"window": "1"}, "expected a window of at least 2 frames, found 1"),
        ({"window": "few"}, "expected window as a whole number in the hello, found 'few'"),
        ({"views": "5"}, f"expected cameras as a list of 5 names in the hello, found {json.dumps(CAMERAS)}"),
        ({"cameras": "CAM_FRONT"}, "expected cameras as a list in the hello, found CAM_FRONT"),
        (
            {"cameras": json.dumps(["A"] * 6)},
            "expected cameras with different names, found A, A, A, A, A, A",
        ),
        (
            {"image_sizes": "[[64, 32]]"},
            "expected image_sizes as a list of 6 [width, height] in the hello, found [[64, 32]]",
        ),
        ({"fps": "fast"}, "expected fps as a number in the hello, found 'fast'"),
        ({"fps": "0"}, "expected a positive number of frames per second, found 0.0"),
        ({"fps": None}, f"expected the text fps in the hello, {NO_TEXT}"),
        ({"cameras": None}, f"expected the text cameras in the hello, {NO_TEXT}"),
        ({"image_sizes": None}, f"expected the text image_sizes in the hello, {NO_TEXT}"),
        ({"condition_size": "32"}, "expected condition_size H,W in the hello, found '32'"),
        ({"condition_size": "32,72"}, "expected height and width in multiples of 16 up to 384, found 32x72"),
        ({"condition_size": "32,400"}, "expected height and width in multiples of 16 up to 384, found 32x400"),
    ],
)
def test_other_hellos_are_refused(
    capsys: pytest.CaptureFixture[str], base: Path, changed: dict[str, str | None], expected: str
) -> None:
    texts = {name: text for name, text in {**HELLO, **changed}.items() if text is not None}
    assert failure(capsys, arguments(base), pack(texts, {})) == expected


def test_other_requests_are_refused(capsys: pytest.CaptureFixture[str], base: Path) -> None:
    hello = pack(HELLO, {})
    texts, tensors = request(*window())

    def refused(texts: dict[str, str], tensors: dict[str, Array]) -> str:
        return failure(capsys, arguments(base), hello, pack(texts, tensors))

    short = {name: tensor[:2] for name, tensor in tensors.items()}
    assert refused(texts, short) == "expected the tensor latents of [3, 6, 16, 4, 8], found [2, 6, 16, 4, 8]"
    without = {name: tensor for name, tensor in tensors.items() if name != "action"}
    assert refused(texts, without) == "expected the tensor action of [3, 3], found none"
    prompts = {**texts, "prompts": '["", ""]'}
    expected = "expected prompts as a list of 3 texts, or of lists of 6 texts, in the call, found "
    assert refused(prompts, tensors) == expected + '["", ""]'
    prompts = {**texts, "prompts": '["", "", ["a", "b"]]'}
    assert refused(prompts, tensors) == expected + '["", "", ["a", "b"]]'
    dropped = {**texts, "dropped": '["layout", ["color"]]'}
    assert refused(dropped, tensors) == 'expected dropped as a list of texts in the call, found ["layout", ["color"]]'
    unknown = {**texts, "dropped": '["text"]'}
    assert refused(unknown, tensors) == "expected parts of layout, action, color, depth, found text"
    assert refused({"ask": "train"}, {}) == "expected ask of predict, encode or decode, found train"
    image = {"images": np.zeros((V, 3, H, H), np.float32)}
    assert refused({"ask": "encode"}, image) == "expected the tensor images of [6, 3, 32, 64], found [6, 3, 32, 32]"
    latents = {"latents": np.full_like(tensors["latents"], np.inf)}
    found = refused(texts, {**tensors, **latents})
    assert found == "expected a finite prediction, found infinite or undefined values (is bf16 used?)"


def test_other_streams_are_refused(capsys: pytest.CaptureFixture[str], base: Path) -> None:
    message = pack(HELLO, {})
    found = failure(capsys, arguments(base), message[:100])
    assert found == f"expected a message of {len(message) - 8} bytes, found the end after 92"
    found = failure(capsys, arguments(base), message[:3])
    assert found == "expected the length of a message in 8 bytes, found the end after 3"
    other = bytearray(pack({}, {"a": np.zeros(1, np.float32)}))
    other[other.index(b"F32") : other.index(b"F32") + 3] = b"I32"
    found = failure(capsys, arguments(base), bytes(other))
    assert found == f"expected a message of safetensors with tensors of F32, U8, U16, found {len(other) - 8} bytes: a of I32"
    found = failure(capsys, arguments(base), b"GET / HTTP/1.1\r\n")
    assert re.fullmatch(r"expected a message of at most 34359738368 bytes, found \d+", found)
    damaged = b"\x10" + bytes(7) + b"\x08" + bytes(7) + b"not JSON"
    found = failure(capsys, arguments(base), damaged)
    assert found.startswith("expected a message of safetensors with tensors of F32, U8, U16, found 16 bytes: ")
    options = command.parser().parse_args(arguments(base))
    assert command.run(options, streams.BytesIO(), streams.BytesIO()) == 0


def test_messages_are_safetensors() -> None:
    tensors = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.zeros((0, 2), np.float32)}
    stream = streams.BytesIO()
    messages.write(stream, {"x": "é"}, tensors)
    texts, found = unpack(stream.getvalue()[8:])
    assert texts == {"x": "é"} and found.keys() == tensors.keys()
    stream.seek(0)
    again = messages.read(stream)
    assert again is not None and again.texts == texts
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(found[name], tensor)
        np.testing.assert_array_equal(again.tensors[name], tensor)
    assert messages.read(stream) is None


@pytest.mark.parametrize(
    ("missing", "text"),
    [
        ("vae", "vae"),
        ("vae/config.json", "vae/config.json"),
        ("text_encoder_3/model.safetensors", "text_encoder_3/*.safetensors or text_encoder_3/*.bin"),
        ("tokenizer_2", "tokenizer_2"),
        ("tokenizer_3/tokenizer.json", "tokenizer_3/tokenizer.json or tokenizer_3/spiece.model"),
    ],
)
def test_missing_parts_are_named(
    capsys: pytest.CaptureFixture[str], base: Path, tmp_path: Path, missing: str, text: str
) -> None:
    copy = tmp_path / "base"
    shutil.copytree(base, copy)
    path = copy / missing
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    found = failure(capsys, arguments(copy))
    assert found == f"expected a folder of Stable Diffusion 3.5 with {text}, found none: {copy}"


def test_other_files_are_refused(capsys: pytest.CaptureFixture[str], base: Path, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing"
    assert failure(capsys, arguments(nothing)) == f"expected a folder of Stable Diffusion 3.5, found none: {nothing}"
    copy = tmp_path / "base"
    shutil.copytree(base, copy)
    (copy / "vae" / "config.json").write_text("{")
    found = failure(capsys, arguments(copy))
    assert found.startswith("expected a variational autoencoder, found ") and found.endswith(f": {copy / 'vae'}")
    diffusers.AutoencoderKL(block_out_channels=(32,), latent_channels=4).save_pretrained(copy / "vae")
    found = failure(capsys, arguments(copy))
    expected = "expected latents of 16 channels at 1/8 of the size of images, found 4 at 1/1"
    assert found == f"{expected}: {copy / 'vae'}"
    shutil.rmtree(copy / "vae")
    shutil.copytree(base / "vae", copy / "vae")
    (copy / "text_encoder_2" / "model.safetensors").write_bytes(b"damaged")
    found = failure(capsys, arguments(copy))
    assert found.startswith("expected a CLIPTextModelWithProjection, found ")
    assert found.endswith(f": {copy / 'text_encoder_2'}")
    shutil.rmtree(copy / "text_encoder_2")
    shutil.copytree(base / "text_encoder", copy / "text_encoder_2")
    assert failure(capsys, arguments(copy)) == f"expected text encoders of 24 pooled channels, found 8 + 8: {copy}"
    config = tmp_path / "config.json"
    config.write_text('{"colour": 1}')
    found = failure(capsys, arguments(base, config=str(config)))
    assert found == f"expected keys of the network, found colour: {config}"
    weights = tmp_path / "w.pth"
    weights.write_bytes(b"hello, world")
    found = failure(capsys, arguments(base, weights=str(weights)))
    assert found == f"expected a checkpoint of tensors, found a file that begins with b'hello, world': {weights}"
    found = failure(capsys, arguments(base, weights=str(tmp_path / "none.pth")))
    assert found == f"[Errno 2] No such file or directory: '{tmp_path / 'none.pth'}'"


def test_devices_and_memory(capsys: pytest.CaptureFixture[str], base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = failure(capsys, arguments(base, device="tpu"))
    assert found == "expected --device cuda, cuda:N or cpu, found tpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    found = failure(capsys, arguments(base, device="cuda"))
    assert found == "expected a GPU for --device cuda, found 0 that PyTorch can use (--device cpu is slow)"

    def fails(*_: Any) -> None:
        raise torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nMore.")

    monkeypatch.setattr(Denoiser, "__call__", fails)
    found = failure(capsys, arguments(base), pack(HELLO, {}), pack(*request(*window())))
    assert found == (
        "out of memory on cpu with --dtype f32: use bf16, a smaller size in the recipe, a smaller --window or "
        "--cached-frames (CUDA out of memory. Tried to allocate 2.00 GiB.)"
    )


def run_process(arguments: list[str], sent: bytes = b"", **environment: str) -> "subprocess.CompletedProcess[bytes]":
    command = [sys.executable, "-m", "pskel.models.pas", *arguments]
    return subprocess.run(command, env={**os.environ, **environment}, input=sent, capture_output=True, check=False)


@pytest.mark.parametrize(
    ("package", "expected"),
    [
        ("torch", "pskel.models.pas needs PyTorch, diffusers and safetensors: pip install 'pskel[pas]'"),
        ("transformers", "the denoiser of pskel.models.pas needs transformers: pip install 'pskel[pas]'"),
    ],
)
def test_a_missing_package_is_one_line(base: Path, tmp_path: Path, package: str, expected: str) -> None:
    (tmp_path / f"{package}.py").write_text(f"raise ImportError('no {package}')")
    done = run_process(arguments(base), PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stdout, done.stderr.decode()) == (1, b"", f"pskel.models.pas: {expected}\n")


def test_an_error_of_the_process_is_one_line(base: Path) -> None:
    done = run_process(arguments(base), pack({**HELLO, "sampler": "ddim", "prediction": "sample"}, {}))
    expected = "pskel.models.pas: expected --sampler flow_match, found ddim with prediction sample\n"
    assert (done.returncode, done.stdout, done.stderr.decode()) == (1, b"", expected)
