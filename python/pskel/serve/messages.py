"""Answers that both services share."""

from __future__ import annotations

from typing import TypeVar

import grpc

import pskel
from pskel.alpasim import API_VERSION, common_pb2, sensorsim_pb2, video_model_pb2

from .errors import RequestError

Message = TypeVar(
    "Message", sensorsim_pb2.AggregatedRenderReturn, sensorsim_pb2.BatchRGBRenderReturn, video_model_pb2.VideoChunkReturn
)

#: Largest message in each direction, bytes; that of AlpaSim's runtime.
MAX_MESSAGE = 64 << 20


def version() -> common_pb2.VersionId:
    """Return the version of this package and of the schemas."""
    major, minor, patch = API_VERSION
    api = common_pb2.VersionId.APIVersion(major=major, minor=minor, patch=patch)
    return common_pb2.VersionId(version_id=f"pskel {pskel.__version__}", git_hash="", grpc_api_version=api)


def sized(answer: Message) -> Message:
    """Return an answer after checking that its receiver takes it. Raises ``RequestError``."""
    if answer.ByteSize() > MAX_MESSAGE:
        text = f"expected an answer of at most {MAX_MESSAGE} bytes, found {answer.ByteSize()}: ask for fewer images, or for JPEG"
        raise RequestError(grpc.StatusCode.RESOURCE_EXHAUSTED, text)
    return answer
