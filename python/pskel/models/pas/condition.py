"""Moved to ``pskel.models._condition``."""

from .._condition import *  # noqa: F401, F403
