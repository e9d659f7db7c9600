"""Export of condition maps, with the options of ``pskel export`` as keyword arguments."""

from __future__ import annotations

import inspect
import json
from collections.abc import Sequence
from os import PathLike
from typing import Any, TypedDict

from ._build import progress_bar
from ._pskel import Export


class Failure(TypedDict):
    """A log or shard that failed."""

    name: str
    error: str


class ExportReport(TypedDict):
    """Counts of shards, and everything that was skipped or failed."""

    written: int
    present: int
    busy: int
    samples: int
    built: int
    notes: dict[str, int]
    failures: list[Failure]
    complete: bool


class _Bar:
    """Shows the key frames done in a tqdm bar."""

    def __init__(self, tqdm: Any, frames: int) -> None:
        self._bar = tqdm(total=frames, unit="frame")

    def frame(self, shard: str) -> None:
        self._bar.set_postfix_str(shard)
        self._bar.update()

    def skip(self, frames: int) -> None:
        self._bar.update(frames)

    def close(self) -> None:
        self._bar.close()


def export(
    logs: str | Sequence[str],
    out: str | PathLike[str],
    *,
    layout: str,
    skeletons: str | PathLike[str],
    only: tuple[int, int] | None = None,
    jobs: int = 1,
    shard_frames: int = 256,
    frames: tuple[int, int] | None = None,
    between_images: bool = False,
    hz: float | None = None,
    images: bool = False,
    verify: bool = False,
    format: str = "png",
    color_folder: str = "proj_clr",
    validation_logs: Sequence[str] | None = None,
    captions: str | PathLike[str] | None = None,
    annotations: str | PathLike[str] | None = None,
    sensor_root: str | PathLike[str] | None = None,
    map_root: str | PathLike[str] | None = None,
    allow_outside: bool = False,
    missing: str = "skip",
    ring_is: str = "auto",
    image_distortion: str = "usual",
    maps: Sequence[str] | None = None,
    size: Sequence[int] | None = None,
    out_size: Sequence[int] | None = None,
    splat: str | None = None,
    radius: float = 100.0,
    depth_bins: str = "linear",
    depth_embedding: str = "continuous",
    far: float | None = None,
    occlusion: str = "scene",
    template_fit: str = "box",
    color_filter: str = "bilinear",
    line_width: str = "scaled",
    map_layers: str = "lanes",
    min_actor_points: int = 20000,
    templates: str | PathLike[str] | None = None,
    default_templates: bool = True,
    augment: int | None = None,
    augment_share: float | None = None,
    augment_color_only: bool = False,
    rasterizer: str = "auto",
    device: str | int | None = None,
    gpu_memory: int | None = None,
    memory: int | None = None,
    no_occlusion_culling: bool = False,
    progress: bool = False,
) -> ExportReport:
    """Export the condition maps of logs into a folder; existing shards are skipped.

    Parameters
    ----------
    logs : str or sequence of str
        Logs as ``pskel.Log`` opens them; ``"#*"`` is every scene of a nuScenes version, and a folder of nuPlan or
        Argoverse 2 logs is all of them.
    out : path
        Folder to write. Several processes may write to it.
    layout : str
        Layout of the files: frames, pas-cache, opendwm-preview, webdataset, streetcrafter, freevs, mcap,
        alpasim, world-scenario or cosmos-video.
    skeletons : path
        Folder of skeletons, one per log and named after it; those that do not exist are built.
    only : (I, N), optional
        Write only part I (counted from 0) of N parts of the shard list.
    jobs : int
        Number of logs that are exported at a time, each with a device of its own, 1 to 64.
    shard_frames : int
        Key frames per shard. The layout alpasim has whole logs.
    frames : (first, end), optional
        Range of key frames of each log, numbered from 0, ``end`` excluded. By default all.
    between_images : bool
        Also export the images between key frames (nuScenes: 12 Hz).
    hz : float, optional
        Export samples at this rate (0.1 to 100 per second) instead of key frames; ego and actors are interpolated.
    images : bool
        Also export the recorded images, without lens distortion and at the size of the maps; the layouts
        streetcrafter and freevs have them in any case.
    verify : bool
        Compare the checksums of existing shards, and write those that differ again.
    format : {"png", "safetensors"}
        Files of maps; safetensors only with ``layout="webdataset"``.
    color_folder : str
        Folder of the color maps in the layout pas-cache.
    validation_logs : sequence of str, optional
        Logs of the validation split in the layout streetcrafter, by their names in shards. By default both splits
        have all logs.
    captions : path, optional
        JSON file of captions by name of a log or token of an image.
    annotations : path, optional
        JSON file of annotations for the prompt: ``{"weather": "Sunny", "city": "Boston"}``, both optional.
    sensor_root : path, optional
        Folder of sweeps and images, if not in the data set's usual place.
    map_root : path, optional
        Folder of maps, if not in the data set's usual place.
    allow_outside : bool
        Also read files outside the data set's folder that it names: only for data sets from trusted sources.
    missing : {"skip", "error"}
        Missing and damaged parts of logs: skip and count them, or fail with the first.
    ring_is : {"auto", "device", "beam"}
        What the ring numbers of sweeps are.
    image_distortion : {"usual", "apply", "ignore"}
        Whether recorded images have the lens distortion that the calibration states.
    maps : sequence of {"color", "depth", "class", "instance", "boxes", "map", "point", "tensor"}, optional
        Maps to render; by default color, depth, class, instance, boxes, and map if the log has an HD map.
    size : (height, width), optional
        Size to render at, pixels; scales the intrinsics. By default the size of the cameras.
    out_size : (height, width), optional
        Size of the maps, pixels, to which they are reduced after rendering. By default ``size``.
    splat : str, optional
        Splat radius by depth, ``Z:R,..``: up to Z meters a point covers (2R+1) x (2R+1) pixels of ``size``; points
        beyond the last Z are culled. By default ``15:2,35:1,100:0``.
    radius : float
        Distance from the ego along the global x and y axes up to which points are used, meters.
    depth_bins : {"linear", "log"}
        Scale of the depth bins in PNG files and the tensor.
    depth_embedding : {"continuous", "discrete", "both"}
        Depth in the tensor: metric values, their sines and cosines, or both.
    far : float, optional
        End of the last depth bin, meters. By default ``radius``.
    occlusion : {"scene", "actors"}
        Occluders of actors in class and instance maps: the whole scene, or only other actors.
    template_fit : {"box", "none"}
        Whether templates are scaled to the box of the actor.
    color_filter : {"bilinear", "valid-area", "visible-area"}
        Filter for reducing color.
    line_width : {"scaled", "fixed"}
        Width of the lines in boxes and map.
    map_layers : {"lanes", "dividers"}
        Outlines in map.
    min_actor_points : int
        Actors with more points than this are rendered with their own points in depth, class and instance maps; others
        with the template of their kind, if there is one.
    templates : path, optional
        Folder of ``pskel templates``, used for kinds without a template in the skeleton.
    default_templates : bool
        Whether the built-in templates of sedan, suv, pickup, pedestrian and bike are used for kinds without another
        one.
    augment : int, optional
        Seed for degrading a share of the assets as in training. By default none is degraded.
    augment_share : float, optional
        Share of the assets that ``augment`` degrades, 0 to 1. By default 0.8.
    augment_color_only : bool
        With ``augment``, whether all maps but color stay unchanged.
    rasterizer : {"auto", "compute", "graphics", "cpu"}
        Vulkan with 64-bit atomics (compute), its graphics pipeline, the processor (cpu, needs no driver), or the
        fastest one. All give the same maps.
    device : str or int, optional
        Vulkan device: index, UUID, PCI address or part of the name. By default ``PSKEL_DEVICE``, else the fastest.
    gpu_memory : int, optional
        Device memory for points, MiB; the least recently seen ones beyond it are evicted.
    memory : int, optional
        Memory for points, MiB, likewise (cpu only). By default 2048, or what a frame needs if that is more.
    no_occlusion_culling : bool
        Draw points that nearer ones hide, too (cpu only); the maps are the same.
    progress : bool
        Show a bar; needs tqdm. Ctrl-C stops in any case, and the same call continues.

    Returns
    -------
    ExportReport
        Counts of shards and samples, and the failed logs and shards.

    Raises
    ------
    ValueError
        For invalid options.
    Error
        If the folder cannot be written, or holds an export with other options.
    """
    keywords = locals()
    job = Export([logs] if isinstance(logs, str) else list(logs), out, keywords)
    bar = None
    if progress and (tqdm := progress_bar()):
        bar = _Bar(tqdm, sum(end - first for _, _, first, end in job.shards))
    try:
        report: ExportReport = json.loads(job.run(progress=bar))
        return report
    finally:
        if bar is not None:
            bar.close()


def defaults() -> dict[str, Any]:
    """Return the keyword arguments of ``export`` that have defaults."""
    parameters = inspect.signature(export).parameters.values()
    return {each.name: each.default for each in parameters if each.default is not each.empty}
