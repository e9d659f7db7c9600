"""Moved to ``pskel.models._rig``."""

from .._rig import *  # noqa: F401, F403
