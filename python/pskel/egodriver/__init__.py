"""Rollouts with driving policies of AlpaSim: ``python -m pskel.egodriver LOG --skeleton SK --driver HOST:PORT --out DIR --steps N``.

The closed loop of ``pskel simulate`` is the runtime, a server of ``egodriver.EgodriverService`` is the policy. This package is a
planner of docs/src/reference/planner.md that translates between both, so metrics, video, page and ``--resume`` are as in every rollout.
It needs the extra ``alpasim`` (grpcio and protobuf); JPEG images need Pillow.

Frames: "local" is the global frame of the log, moved so that its origin is near the start of the rollout, because messages have
32-bit floats. "Rig" is the ego frame of the log: x forward, y left, z up, origin on the ground below the rear axle. Cameras have
their optical frame: x right, y down, z forward.
"""

from .driver import Driver, DriverError

__all__ = ["Driver", "DriverError"]
