"""Generates distortion.json: points projected by OpenCV's projectPoints, the reference for src/geometry/distortion.rs.

Run: python3 tests/peers/distortion.py  (opencv-python 5.0, numpy 2.4)
"""

import json
import pathlib

import cv2
import numpy as np

# width, height, fx, fy, cx, cy, largest half angle in degrees, k1 k2 p1 p2 k3
CAMERAS = {
    "barrel": (1920, 1080, 1545.0, 1545.0, 960.0, 560.0, 42, [-0.356123, 0.172545, -0.00213, 0.000464, -0.05231]),
    "strong barrel": (1600, 900, 700.0, 705.5, 812.3, 441.7, 48, [-0.28, 0.071, 0.0011, -0.0007, -0.0079]),
    "pincushion": (1280, 720, 1100.0, 1090.0, 630.0, 371.0, 31, [0.18, -0.05, -0.004, 0.006, 0.012]),
    "tangential": (640, 480, 500.0, 500.0, 320.0, 240.0, 45, [0.0, 0.0, 0.01, -0.02, 0.0]),
}
POINTS = 70

rng = np.random.default_rng(7)
cameras = []
for name, (width, height, fx, fy, cx, cy, half_angle, coefficients) in CAMERAS.items():
    angle = np.radians(half_angle) * np.sqrt(rng.random(POINTS))
    turn = rng.random(POINTS) * 2 * np.pi
    depth = rng.uniform(0.5, 80, POINTS)
    points = np.stack([np.tan(angle) * np.cos(turn), np.tan(angle) * np.sin(turn), np.ones(POINTS)], 1) * depth[:, None]
    points[0] = [0, 0, 3]
    intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), intrinsics, np.array(coefficients))
    cameras.append({
        "name": name,
        "width": width,
        "height": height,
        "intrinsics": intrinsics.tolist(),
        "distortion": coefficients,
        "points": points.tolist(),
        "pixels": pixels[:, 0].tolist(),
    })
path = pathlib.Path(__file__).with_name("distortion.json")
path.write_text(json.dumps({"cameras": cameras}, separators=(",", ":")) + "\n")
