"""Resources that run out: threads and memory."""

import os

import pskel
import pytest
from conftest import TOWN, Run


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become a user without other processes")
def test_refused_threads_raise_an_error_that_names_the_variables(run: Run) -> None:
    program = f"""
import os, resource
import pskel
os.setuid(54330)
hard = resource.getrlimit(resource.RLIMIT_NPROC)[1]
for _ in range(2):
    resource.setrlimit(resource.RLIMIT_NPROC, (1, hard))
    try:
        pskel.Log({TOWN!r})
    except pskel.Error as error:
        print(error)
resource.setrlimit(resource.RLIMIT_NPROC, (hard, hard))
print(len(pskel.Log({TOWN!r})))
"""
    lines = run("-c", program).stdout.splitlines()
    assert len(lines) == 3 and lines[2] == "4", lines
    for line in lines[:2]:
        assert line.startswith("cannot start the threads for parallel work, only "), line
        assert "RAYON_NUM_THREADS=1" in line and "pids.max" in line, line


def test_maps_beyond_the_budget_are_refused_with_the_number(run: Run, skeleton: pskel.Skeleton) -> None:
    program = f"""
import os
os.environ["PSKEL_MEMORY"] = "1G"
import numpy as np
import pskel
log = pskel.Log({TOWN!r})
renderer = pskel.Renderer(pskel.Skeleton({str(skeleton.path)!r}), size=(8192, 8192), rasterizer="cpu")
points = np.array([[0.0, 0.0, 5.0, 255.0, 0.0, 0.0]])
pinhole = np.array([[[100.0, 0.0, 50.0], [0.0, 100.0, 50.0], [0.0, 0.0, 1.0]]])
for call in (
    lambda: renderer.render(log[0]),
    lambda: pskel.splat(points, pinhole, np.eye(4)[None], (16384, 16384), rasterizer="cpu"),
):
    try:
        call()
    except pskel.RenderError as error:
        print(error)
"""
    lines = run("-c", program).stdout.splitlines()
    assert [line.split(" needs ")[0] for line in lines] == [
        "rendering 6 views of up to 8192x8192 pixels",
        "rendering a view of 16384x16384 pixels",
    ], lines
    assert all("limited by PSKEL_MEMORY" in line for line in lines)
