"""Errors that end a training. The text of each is one line that says what to do."""

from __future__ import annotations

__all__ = ["CheckpointError", "ConfigError", "DataError", "LossError", "TrainError", "first_line"]


class TrainError(Exception):
    """The training cannot begin or go on."""

    of_all = False
    """Whether all processes of the training raise it: the main process alone says so."""


class ConfigError(TrainError):
    """The configuration is invalid."""

    of_all = True


class DataError(TrainError):
    """Clips cannot be read, or are not what the configuration asks for."""


class CheckpointError(TrainError):
    """A checkpoint or another output cannot be read or written."""


class LossError(TrainError):
    """A loss or a gradient is not finite."""

    of_all = True


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, or its type if it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
