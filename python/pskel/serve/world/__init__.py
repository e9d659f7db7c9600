"""World model of AlpaSim: ``omnidreams.video_model.WorldModelService`` with the generators of ``pskel simulate``.

A session is a rollout: cameras, first frames and a text, then chunks of poses of the rig and of actors. Each frame of a chunk is a
committed planning step; its forecasts are the later frames of the same chunk.
"""

from .service import WorldModel
from .session import Settings

__all__ = ["Settings", "WorldModel"]
