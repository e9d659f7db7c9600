"""Generates lines.json: lines 8 px wide drawn by Pillow, the reference for raster::draw_lines.

The lines are drawn FINE times larger and the middle pixels are sampled, see layout.py. Run: python3 tests/peers/lines.py
(Pillow 13.0, numpy 2.4)
"""

import itertools
import json
import pathlib

from layout import drawn

SIZE = (80, 120)  # height, width
FINE = 5
LINES = [  # end points, pixels; later lines cover earlier ones
    [5.3, 9.8, 110.6, 14.1], [20.5, 70.2, 100.9, 61.7], [30.1, -5.4, 33.6, 77.0], [90.0, 75.5, 96.4, 6.2],
    [50.7, 30.3, 75.2, 55.9], [12.9, 58.6, 28.4, 24.8], [-20.0, 40.0, 45.3, 40.0], [60.2, 20.0, 60.2, 33.7],
    [104.8, 30.6, 140.0, 95.5],
]

image = drawn([(tuple(line[:2]), tuple(line[2:]), (number, 0, 0)) for number, line in enumerate(LINES, 1)], SIZE, FINE)
numbers = [int(pixel) for pixel in image.getchannel("R").tobytes()]
runs = [[number, len(list(run))] for number, run in itertools.groupby(numbers)]
out = {"height": SIZE[0], "width": SIZE[1], "lines": LINES, "runs": list(itertools.chain(*runs))}
path = pathlib.Path(__file__).with_name("lines.json")
path.write_text(json.dumps(out, separators=(",", ":")) + "\n")
