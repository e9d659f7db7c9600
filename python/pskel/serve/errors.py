"""Requests that cannot be answered."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from typing import Any, TypeVar

import grpc

import pskel

Answer = TypeVar("Answer")


class RequestError(Exception):
    """A request that is answered with a status; the text is one line."""

    def __init__(self, code: grpc.StatusCode, text: str) -> None:
        super().__init__(text)
        self.code = code


def invalid(expected: str, found: object) -> RequestError:
    """Return the error of a value that is not as expected."""
    return RequestError(grpc.StatusCode.INVALID_ARGUMENT, f"expected {expected}, found {found}")


def unknown(expected: str, found: object) -> RequestError:
    """Return the error of a name that nothing has."""
    return RequestError(grpc.StatusCode.NOT_FOUND, f"expected {expected}, found {found}")


def answered(context: Any, answer: Callable[[], Answer]) -> Answer:
    """Return an answer, or end the call with the status of its error."""
    try:
        return answer()
    except RequestError as error:
        code, text = error.code, str(error)
    except Exception as error:  # a call must not end the server
        if not isinstance(error, pskel.Error):
            traceback.print_exc()
        code, text = grpc.StatusCode.INTERNAL, f"{type(error).__name__}: {error}"
    text = " ".join(text.split())
    print(f"pskel.serve: {code.name}: {text}", file=sys.stderr, flush=True)
    context.abort(code, text[:1000])
    raise AssertionError  # abort raises
