"""Renderer of AlpaSim: ``python -m pskel.serve SKELETON.. --log LOG..`` serves ``nre.grpc.protos.sensorsim.SensorsimService``.

A scene is a log with its skeleton. Requests name a scene, cameras with their poses, and tracks with the poses of their boxes; the
answers are images. Requests are independent of each other, so the server keeps no state but open scenes. It needs the extra
``alpasim``.
"""

from .service import Service, serve

__all__ = ["Service", "serve"]
