"""Requests to a server by HTTP, with the standard library."""

from __future__ import annotations

import http.client
import json
import socket
import time
import urllib.error
import urllib.request
from typing import Any, NamedTuple

__all__ = ["Answer", "Server"]

_MAX_BYTES = 64 << 20
_PART_BYTES = 1 << 16
#: The same since Python 3.10.
_TIMEOUTS = (TimeoutError, socket.timeout)


class Answer(NamedTuple):
    """Status, type and content of an answer."""

    status: int
    content_type: str
    content: bytes


class Server:
    """A server by its URL. Calls raise ``ValueError`` in one line if it does not answer in time, or with an error."""

    def __init__(self, url: str, timeout_s: float) -> None:
        if not url.startswith(("http://", "https://")):
            raise ValueError(f"expected --url http://HOST:PORT, found {url}")
        self._url, self._timeout_s = url.rstrip("/"), timeout_s

    def get(self, path: str) -> Answer:
        """Ask for a path, with a slash at its beginning."""
        return self._call(urllib.request.Request(self._url + path))

    def post(self, path: str, value: Any) -> Answer:
        """Send a value as JSON; numbers must be finite."""
        content = json.dumps(value, allow_nan=False).encode()
        return self._call(urllib.request.Request(self._url + path, content, {"Content-Type": "application/json"}, method="POST"))

    def _call(self, request: urllib.request.Request) -> Answer:
        asked, end_s = f"{request.get_method()} {request.full_url}", time.monotonic() + self._timeout_s
        try:
            with urllib.request.urlopen(request, timeout=self._timeout_s) as answer:
                content = b""
                while part := answer.read1(_PART_BYTES):
                    content += part
                    if len(content) > _MAX_BYTES:
                        raise ValueError(f"expected an answer of {asked} of at most {_MAX_BYTES} bytes, found more")
                    if time.monotonic() > end_s:
                        raise TimeoutError
                if answer.length:
                    raise ConnectionError(f"{len(content)} bytes, and {answer.length} less than announced")
                return Answer(answer.status, answer.headers.get_content_type(), content)
        except urllib.error.HTTPError as error:
            said = " ".join(error.read(300).decode(errors="replace").split())
            raise ValueError(f"expected an answer of {asked}, found status {error.code}: {said}") from None
        except _TIMEOUTS:
            raise ValueError(f"expected an answer of {asked} within {self._timeout_s:g} s, found none") from None
        except (OSError, http.client.HTTPException) as error:
            reason = getattr(error, "reason", error)
            if isinstance(reason, _TIMEOUTS):
                raise ValueError(f"expected an answer of {asked} within {self._timeout_s:g} s, found none") from None
            raise ValueError(f"expected an answer of {asked}, found {reason or type(error).__name__}") from None
