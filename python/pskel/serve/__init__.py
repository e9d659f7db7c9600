"""Renderer and world model of AlpaSim: ``python -m pskel.serve SKELETON.. --log LOG..``.

A scene is a log with its skeleton. ``nre.grpc.protos.sensorsim.SensorsimService`` answers requests that name a scene, cameras with
their poses, and tracks with the poses of their boxes; they are independent of each other. With ``--generator``,
``omnidreams.video_model.WorldModelService`` generates the images of sessions. It needs the extra ``alpasim``.
"""

from .service import Service, serve

__all__ = ["Service", "serve"]
