"""Requests that cannot be answered."""

from __future__ import annotations

import grpc


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
