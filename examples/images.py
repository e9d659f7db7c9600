#!/usr/bin/env python3
"""An image generator (docs/src/reference/images.md) without a network: the color map with its holes filled.
Uses standard input and output (images.py), or a socket named as for pskel (images.py unix:PATH|tcp:HOST:PORT)."""
import sys

import numpy as np

import pskel
from pskel import images


class Fill(pskel.ImageGenerator):
    maps = ("color", "depth")

    def __init__(self, hello):
        self.image_size = hello.condition_size

    def generate(self, request):  # frame 0 is the planning step, frames 1 .. are forecasts
        filled = pskel.fill_holes(request.maps["color"][0], request.maps["depth"][0])
        print(f"frame {request.frame}: filled {np.isinf(request.maps['depth'][0]).mean():.0%} of the pixels")  # to standard error
        return filled


if __name__ == "__main__":
    images.serve(Fill, *sys.argv[1:2])
