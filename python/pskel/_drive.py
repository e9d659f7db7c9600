"""The live page of a log."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from os import PathLike
from types import TracebackType

from ._pskel import Error, Log, Skeleton


class Drive:
    """A running live page (`pskel drive`), in a process of its own. Ends with `close`, with its `with` block, or with Python.

    In a notebook, the value of a cell shows the page.
    """

    def __init__(self, process: subprocess.Popen[str], url: str) -> None:
        self._process = process
        self.url = url
        """Address of the page; contains a secret token."""

    def close(self) -> None:
        """End the page. Nothing happens if it has ended."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def wait(self) -> None:
        """Wait until the page ends, for instance by Ctrl-C."""
        self._process.wait()

    def __enter__(self) -> Drive:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __del__(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="760" style="border: 0" title="pskel drive"></iframe>'

    def __repr__(self) -> str:
        state = "running" if self._process.poll() is None else "ended"
        return f"<pskel.Drive {state}: {self.url.split('?')[0]}>"


def drive(
    log: Log | str,
    skeleton: Skeleton | str | PathLike[str] | None = None,
    *,
    out: str | PathLike[str] = "out/drive",
    port: int | None = None,
    generator: str | None = None,
    generate_hz: float | None = None,
    open_browser: bool = False,
) -> Drive:
    """Show a log on a live page in the browser, to look around and to drive in it.

    Parameters
    ----------
    log : Log or str
        Log, or its name.
    skeleton : Skeleton or path, optional
        Skeleton of the log; it is built if it does not exist. By default below `out`.
    out : path, optional
        Folder for saved drives.
    port : int, optional
        Port to listen on; 0 for any free one. By default 8770, or any free one.
    generator : str, optional
        Generator of images in the loop, as ``pskel drive --generator``: "network", "network:FILE", "fill", "process:COMMAND", ..
    generate_hz : float, optional
        Images that it makes per second. By default the planning rate of the log.
    open_browser : bool, optional
        Whether to open the page in the browser.

    Returns
    -------
    Drive
        The running page. It exists at once and shows the progress while log and skeleton are opened.

    Raises
    ------
    Error
        If the page cannot be served; standard error has the reason.
    """
    source = [log] if isinstance(log, str) else log.arguments
    options = ["--out", os.fspath(out)]
    if skeleton is not None:
        options += ["--skeleton", os.fspath(skeleton.path if isinstance(skeleton, Skeleton) else skeleton)]
    if port is not None:
        options += ["--port", str(port)]
    if generator is not None:
        options += ["--generator", generator]
    if generate_hz is not None:
        options += ["--generate-hz", str(generate_hz)]
    if not open_browser:
        options.append("--no-browser")
    command = [sys.executable, "-m", "pskel", "drive", *source, *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None  # a pipe
    url = process.stdout.readline().strip()
    if not url:
        raise Error(f"pskel drive ended with exit code {process.wait()}; standard error has the reason")
    return Drive(process, url)
