#!/usr/bin/env python3
"""An image generator (docs/src/reference/images.md) without a network: the color map with its holes filled.
Uses standard input and output (images.py), or a socket named as for pskel (images.py unix:PATH|tcp:HOST:PORT)."""
import sys

import numpy as np

import pskel
from pskel import images


class Fill(pskel.ImageGenerator):  # the images of --generator fill with the same --recipe
    references = 3

    def __init__(self, hello):
        self.image_size = hello.condition_size

    def generate(self, request):
        color = request.maps["color"][0]  # of the planning step; further ones would be forecasts
        known = color.any(axis=-1)
        print(f"frame {request.frame}: {1 - known.mean():.0%} of the pixels are holes")  # to standard error
        return pskel.fill_holes(color, np.where(known, 1, np.inf).astype(np.float32))


if __name__ == "__main__":
    images.serve(Fill, *sys.argv[1:2])
