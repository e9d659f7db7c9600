"""Image generators with samplers of their own, in any Python environment with NumPy (docs/src/reference/images.md).

A generator is a subclass of ``ImageGenerator``. ``serve`` answers ``pskel`` with it, on standard input and output or on a
socket; ``Images`` runs it in the same process with a ``pskel.Simulation`` and a ``pskel.Renderer``.
"""

from ._generator import ImageGenerator, ImageRequest, RequestActor
from ._loop import Images
from ._protocol import Hello
from ._server import serve

__all__ = ["Hello", "ImageGenerator", "ImageRequest", "Images", "RequestActor", "serve"]
