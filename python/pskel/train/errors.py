"""Errors that end a training. The text of each is one line that says what to do."""

from __future__ import annotations

__all__ = ["CheckpointError", "ConfigError", "DataError", "LossError", "TrainError", "first_line"]


class TrainError(Exception):
    """The training cannot begin or go on."""


class ConfigError(TrainError):
    """The configuration is invalid."""


class DataError(TrainError):
    """Clips cannot be read, or are not what the configuration asks for."""


class CheckpointError(TrainError):
    """A checkpoint or another output cannot be read or written."""


class LossError(TrainError):
    """A loss or a gradient is not finite."""


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, or its type if it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
