"""The renderer, with the options of ``pskel render`` as keyword arguments."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike

from . import _pskel
from ._pskel import Skeleton


class Renderer(_pskel.Renderer):
    """Renders the condition maps of scenes from a skeleton. Owns a device and the points on it.

    Parameters
    ----------
    skeleton : Skeleton
        Skeleton of the log.
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
    distort : bool
        Render with the lens distortion of the recorded cameras.
    log : str, optional
        Name of the log whose actors are rendered. By default the first one of the skeleton.

    Raises
    ------
    ValueError
        For invalid options.
    RenderError
        Without a suitable device.
    """

    def __new__(
        cls,
        skeleton: Skeleton,
        *,
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
        distort: bool = False,
        log: str | None = None,
    ) -> Renderer:
        """Open the device and upload the points."""
        return super().__new__(cls, skeleton, locals())
