#!/usr/bin/env python3
"""Generates the Python modules of ``python/pskel/alpasim/*.proto`` below a folder: ``ci/protos.py [OUT]`` (default ``python``).

Needs grpcio-tools; the committed modules are those of version 1.62.3 (``pip install grpcio-tools==1.62.3 'setuptools<82'``), whose
output works with every protobuf from 4.25 on. The messages are registered in a pool of their own, because another package with
the schemas of AlpaSim may be imported in the same process, and the default pool takes each name once.
"""

import importlib.resources
import sys
import tempfile
from pathlib import Path

from google.protobuf import descriptor_pb2
from grpc_tools import protoc

PYTHON = Path(__file__).resolve().parent.parent / "python"
FOLDER = "pskel/alpasim"
DEFAULT_POOL = "_descriptor_pool.Default()"


def descriptors(root: Path = PYTHON) -> descriptor_pb2.FileDescriptorSet:
    """The schemas as protoc reads them, without comments."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "set"
        _protoc(root, f"--descriptor_set_out={out}")
        return descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes())


def generate(out: Path) -> None:
    """Write all modules into ``OUT/pskel/alpasim``."""
    (out / FOLDER).mkdir(parents=True, exist_ok=True)
    _protoc(PYTHON, f"--python_out={out}", f"--pyi_out={out}", f"--grpc_python_out={out}")
    for file in descriptors().file:
        stem = out / file.name.removesuffix(".proto")
        module = Path(f"{stem}_pb2.py")
        text = module.read_text()
        if text.count(DEFAULT_POOL) != 1:
            raise SystemExit(f"{module}: expected {DEFAULT_POOL} once, found {text.count(DEFAULT_POOL)} times")
        text = text.replace(DEFAULT_POOL, "_pool.POOL")
        module.write_text(text.replace("# @@protoc_insertion_point(imports)", "from pskel.alpasim import _pool"))
        if file.service:
            Path(f"{stem}_pb2_grpc.pyi").write_text(_stubs(file))
        else:
            Path(f"{stem}_pb2_grpc.py").unlink()


def _protoc(root: Path, *options: str) -> None:
    include = importlib.resources.files("grpc_tools") / "_proto"
    files = sorted(path.relative_to(root).as_posix() for path in (root / FOLDER).glob("*.proto"))
    if protoc.main(["protoc", f"-I{root}", f"-I{include}", *options, *files]) != 0:
        raise SystemExit("protoc failed")


def _stubs(file: descriptor_pb2.FileDescriptorProto) -> str:
    """Types of the client and server classes of a file; grpcio-tools writes none."""
    packages = {
        "common": "common_pb2",
        "egodriver": "egodriver_pb2",
        "nre.grpc.protos.sensorsim": "sensorsim_pb2",
        "omnidreams.video_model": "video_model_pb2",
    }

    def name(full: str) -> str:
        package, _, message = full.removeprefix(".").rpartition(".")
        return f"{packages[package]}.{message}"

    kinds = [name(kind) for s in file.service for m in s.method for kind in (m.input_type, m.output_type)]
    modules = sorted({kind.partition(".")[0] for kind in kinds})
    lines = ["from typing import Any", "", "import grpc", "", f"from pskel.alpasim import {', '.join(modules)}", ""]
    for service in file.service:
        methods = [(m.name, name(m.input_type), name(m.output_type)) for m in service.method]
        lines += [f"class {service.name}Stub:", "    def __init__(self, channel: grpc.Channel) -> None: ..."]
        for method, request, response in methods:
            lines += [f"    def {method}(", f"        self, request: {request}, *, timeout: float | None = None,"]
            lines += ["        metadata: Any = None, wait_for_ready: bool | None = None,", f"    ) -> {response}: ..."]
        lines += ["", f"class {service.name}Servicer:"]
        for method, request, response in methods:
            lines += [f"    def {method}(self, request: {request}, context: Any) -> {response}: ..."]
        lines += [
            "",
            f"def add_{service.name}Servicer_to_server(servicer: {service.name}Servicer, server: grpc.Server) -> None: ...",
        ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else PYTHON)
