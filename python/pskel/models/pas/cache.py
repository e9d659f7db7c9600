"""Moved to ``pskel.models._cache``."""

from .._cache import *  # noqa: F401, F403
