"""Render points, actors and cameras of your own, without a reader for their data set.

python own_points.py out
"""

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pskel


def background() -> npt.NDArray[np.float64]:
    """A road with two walls, `[N, 6]`: global x, y, z in meters; red, green, blue."""
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 40, 60_000)
    side = rng.uniform(-8, 8, 60_000)
    height = np.where(np.abs(side) > 6, rng.uniform(0, 4, 60_000), 0.0)
    side = np.where(height > 0, np.sign(side) * 6, side)
    color = np.where(height[:, None] > 0, [150, 110, 90], [90, 90, 95])
    return np.hstack([np.column_stack([x, side, height]), color])


def car() -> npt.NDArray[np.float64]:
    """Points on a box, in its own frame."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (20_000, 3))
    axis = rng.integers(0, 3, 20_000)
    points[np.arange(20_000), axis] = np.sign(points[np.arange(20_000), axis])
    return np.hstack([points * [2.2, 0.9, 0.8], np.tile([200, 40, 40], (20_000, 1))])


def main(out: Path) -> pskel.Maps:
    size = (4.4, 1.8, 1.6)
    skeleton = pskel.Skeleton.from_points(out / "skeleton", background(), {"car-1": ("vehicle.car", size, car())})
    # From camera axes (x right, y down, z forward) to ego axes (x forward, y left, z up), 1.5 m above the ground.
    ego_from_camera = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])
    intrinsics = [[220, 0, 224], [0, 220, 128], [0, 0, 1]]
    camera = pskel.Camera("front", intrinsics, (256, 448), ego_from_camera)
    pose = np.eye(4)
    pose[:3, 3] = 12.0, 2.0, 0.8
    scene = pskel.Scene(np.eye(4), [camera], [pskel.Actor("car-1", "vehicle.car", size, pose)])
    # Assets of any size are shown in all maps; by default, small ones are replaced by templates in depth and masks.
    maps = ["color", "depth", "instance"]
    with pskel.Renderer(skeleton, maps=maps, min_actor_points=0) as renderer:
        return renderer.render(scene)


if __name__ == "__main__":
    maps = main(Path(sys.argv[1]))
    print(f"{np.isfinite(maps['depth']).mean():.0%} of the pixels see a point")
