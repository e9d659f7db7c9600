"""Moved to ``pskel.models._messages``."""

from .._messages import *  # noqa: F401, F403
