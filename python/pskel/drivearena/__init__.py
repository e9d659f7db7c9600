"""World dreamer and driving agents of DriveArena, which listen for HTTP (docs/src/reference/interop.md#drivearena).

``python -m pskel.drivearena dreamer`` is a generator of the image protocol, ``python -m pskel.drivearena agent`` a planner of
the planner protocol. Both run in any environment with NumPy and Pillow, Python 3.9 or later; the compiled part of ``pskel`` is
not needed.
"""

#: Cameras of all images of DriveArena, in its order.
CAMERAS = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT")
#: Height and width of an image, pixels.
SIZE = (224, 400)
#: Rate of its world dreamer and its agents.
HZ = 2.0

__all__ = ["CAMERAS", "HZ", "SIZE"]
