"""Preparation of data in child processes: skeletons and recordings."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any

from ..errors import DataError, TrainError, first_line
from ..parallel import Processes

__all__ = ["Say", "in_rounds"]

Say = Callable[[str], None]
"""Writes a message for people."""


def in_rounds(processes: Processes, jobs: Sequence[Any], texts: Sequence[str], say: Say) -> None:
    """Do jobs in child processes, one at a time for each process of the training. Raises ``DataError`` if one fails."""
    # A process that is late must not see what another one has done in the meantime.
    jobs, texts = processes.share_object((list(jobs), list(texts)))
    for first in range(0, len(jobs), processes.count):
        failure = None
        mine = first + processes.rank
        if mine < len(jobs):
            function, arguments = jobs[mine]
            say(f"[{mine + 1}/{len(jobs)}] {texts[mine]}")
            try:
                _in_child(function, *arguments)
            except DataError as error:
                failure = str(error)
        with processes.agreed():
            if failure is not None:
                raise DataError(failure)


def _in_child(function: Callable[..., None], *arguments: Any) -> None:
    """Call a function in a process of its own, so that this one opens no device: workers are forked from it.

    Raises ``DataError`` if it fails, or if the process is killed.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_run, args=(sender, function, arguments), daemon=True)
    child.start()
    sender.close()
    try:
        failure = receiver.recv()
    except EOFError:
        child.join()
        raise DataError(
            f"a process that prepares data ended with exit code {child.exitcode} (-9: out of memory?)"
        ) from None
    finally:
        receiver.close()
    child.join()
    if failure is not None:
        raise DataError(failure)


def _run(sender: Connection, function: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        function(*arguments)
        sender.send(None)
    except KeyboardInterrupt:
        pass
    except TrainError as error:
        sender.send(str(error))
    except Exception as error:  # the parent says what happened
        sender.send(f"{type(error).__name__}: {first_line(error)}")


def _end_with_parent() -> None:
    """End this process once its parent has ended, however that was: another start could not write what this one locks."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
