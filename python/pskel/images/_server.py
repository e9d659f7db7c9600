"""Server of the image protocol, version 1 (docs/src/reference/images.md)."""

from __future__ import annotations

import socket
import stat
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from io import BufferedIOBase
from pathlib import Path
from typing import Any, NamedTuple

import numpy.typing as npt

from .. import _messages as messages
from ._generator import ImageGenerator, Settings
from ._protocol import Hello, answer_of, request_of

__all__ = ["serve"]

Create = Callable[[Hello], ImageGenerator]


def serve(create: Create, address: str | None = None) -> None:
    """Answer ``pskel`` with a generator until the connection ends.

    Parameters
    ----------
    create : function
        Called with the ``Hello`` of each connection; returns its ``ImageGenerator``. Load networks before.
    address : str, optional
        ``unix:PATH`` or ``tcp:HOST:PORT`` to listen on, one connection after another, without end. By default standard input
        and output; ``print`` then writes to standard error.

    An exception, also one of ``create`` or ``generate``, is sent to ``pskel``, which ends the rollout with its text. On
    standard input and output it is then raised; on a socket its traceback is printed and the next connection accepted. Raises
    ``ValueError`` for another address, ``OSError`` if it cannot be listened on.
    """
    if address is None:
        with messages.standard_streams() as (source, out):
            _converse(create, _Connection(source, out))
        return
    with listening(address) as server:
        while True:
            peer = server.accept()[0]
            with peer, peer.makefile("rb") as source, peer.makefile("wb") as out:
                try:
                    _converse(create, _Connection(source, out))
                except Exception:  # of any kind: the code of the user
                    traceback.print_exc(file=sys.stderr)


def listening(address: str) -> socket.socket:
    """Listen on ``unix:PATH``, in place of the socket of an earlier run, or on ``tcp:HOST:PORT``."""
    kind, _, where = address.partition(":")
    if kind == "unix" and where:
        path = Path(where)
        if path.exists() and stat.S_ISSOCK(path.stat().st_mode):
            path.unlink()
        server = socket.socket(socket.AF_UNIX)
        try:
            server.bind(where)
            server.listen(1)
        except OSError:
            server.close()
            raise
        return server
    host, _, port = where.rpartition(":")
    if kind != "tcp" or not host or not port.isdecimal():
        raise ValueError(f"expected an address unix:PATH or tcp:HOST:PORT, found {address}")
    return socket.create_server((host, int(port)))


class _Connection(NamedTuple):
    """Messages to and from ``pskel``, which may close the connection at any time."""

    source: BufferedIOBase
    out: BufferedIOBase

    def receive(self) -> messages.Message | None:
        try:
            return messages.read(self.source)
        except ConnectionError:
            return None

    def send(self, texts: Mapping[str, str], tensors: Mapping[str, npt.NDArray[Any]]) -> bool:
        """Returns ``False`` if the connection has ended."""
        try:
            messages.write(self.out, texts, tensors)
        except BaseException as error:  # also an interrupt
            with suppress(OSError):
                self.out.close()  # would raise again at the end, because of what it could not write
            if isinstance(error, ConnectionError):
                return False
            raise
        return True


def _converse(create: Create, connection: _Connection) -> None:
    """Answer the messages of a connection until it ends; sends the text of an exception, and raises it."""
    try:
        first = connection.receive()
        if first is None:
            return
        hello = Hello.parse(first.texts)
        generator = create(hello)
        settings = Settings.of(generator, len(hello.cameras), hello.maps)
        is_open = connection.send(answer_of(settings), {})
        while is_open and (message := connection.receive()) is not None:
            request = request_of(message, hello, settings)
            images = settings.checked(generator.generate(request))
            is_open = connection.send({"frame": str(request.frame)}, {"images": images})
    except Exception as error:
        connection.send({"error": _line(error)}, {})
        raise


def _line(error: Exception) -> str:
    """Text of an exception in one line; with its type unless the text says what was expected."""
    known = str(error) if isinstance(error, ValueError) and str(error) else f"{type(error).__name__}: {error}"
    return " ".join(known.split())[:500]
