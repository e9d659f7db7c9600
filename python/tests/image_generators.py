"""Generators of the tests of the image protocol: image_generators.py CLASS [ADDRESS]."""

import os
import signal
import sys

import numpy as np

import pskel
from pskel import images


class Mean(pskel.ImageGenerator):
    """The mean of the color maps of all frames and of the earlier images, printed about on standard output."""

    maps = ("color",)
    references = 2
    history = 3
    forecasts = 1

    def __init__(self, hello):
        self.image_size = hello.condition_size
        print("hello from Python", hello.log)
        os.system("echo hello from another process")

    def generate(self, request):
        print("frame", request.frame)
        frames = [*request.maps["color"], *request.images]
        return np.mean(frames, axis=0).astype(np.uint8)


class Moody(Mean):
    """Fails at frame 3."""

    def generate(self, request):
        if request.frame == 3:
            raise RuntimeError("no memory\nleft")
        return super().generate(request)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a test that runs in the background ignores it
    images.serve(globals()[sys.argv[1]], *sys.argv[2:3])
