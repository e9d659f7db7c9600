"""Messages and services of AlpaSim (alpasim_grpc 0.54.0): ``common_pb2``, ``sensorsim_pb2``, ``egodriver_pb2``, ``video_model_pb2``.

The modules, and those of their services (``_grpc``), are generated from the ``.proto`` files of this folder by ``ci/protos.py``. Wire
format and service names are taken from AlpaSim (https://github.com/NVlabs/alpasim, Apache-2.0). They need the extra ``alpasim`` (grpcio
and protobuf).
"""

from __future__ import annotations

import importlib

try:
    for _name in ("google.protobuf", "grpc"):
        importlib.import_module(_name)
except ImportError as error:
    raise ImportError("pskel.alpasim needs grpcio and protobuf: pip install 'pskel[alpasim]'") from error

__all__ = ["API_VERSION"]

#: The version of AlpaSim's schemas, as major, minor and patch.
API_VERSION = (0, 54, 0)
