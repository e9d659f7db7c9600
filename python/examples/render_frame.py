"""Render the first frame of a log from two meters further left, and plot color and depth of all cameras.

python render_frame.py nuscenes:/data/nuscenes@v1.0-mini#scene-0061 out
"""

import sys
from pathlib import Path

import numpy as np
import pskel
from matplotlib.figure import Figure


def main(name: str, out: Path) -> None:
    log = pskel.Log(name)
    skeleton = pskel.build(log, out / "skeleton", progress=True)
    with pskel.Renderer(skeleton, out_size=(256, 448), maps=["color", "depth"]) as renderer:
        scene = log[0].move_ego(left_m=2.0)
        maps = renderer.render(scene)
    figure = Figure(figsize=(16, 3.6), layout="constrained")
    axes = figure.subplots(2, len(scene.cameras), squeeze=False)
    for column, camera in enumerate(scene.cameras):
        axes[0, column].imshow(maps["color"][column])
        depth = maps["depth"][column]
        axes[1, column].imshow(np.where(np.isfinite(depth), depth, np.nan), cmap="viridis_r", vmin=0, vmax=60)
        axes[0, column].set_title(camera, fontsize=8)
    for axis in axes.flat:
        axis.set_axis_off()
    figure.savefig(out / "frame.png", dpi=100)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
