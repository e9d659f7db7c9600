"""Recipes: how the maps of a network are rendered. The keys are as in the denoiser protocol."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import ConfigError

__all__ = ["complete", "depth_bins", "difference", "of_export", "renderer_keywords", "size_of"]

BINS: dict[str, Any] = {"scale": "linear", "count": 256, "far_m": 100.0, "gamma": 1.0}
DEFAULTS: dict[str, Any] = {
    "drawn": "256x448",
    "size": "64x112",
    "splat": "15:1,100:0",
    "radius_m": 100.0,
    "color_filter": "visible-area",
    "bins": BINS,
    "min_actor_points": 20000,
    "template_fit": "box",
    "line_width": "fixed",
    "map_layers": "lanes",
}
"""Values of missing keys, as in docs/src/reference/denoiser.md."""

MAX_BINS = 32767
"""Clips have bins of 16 bits with a sign."""
_EPSILON = np.float32(1e-6)


def complete(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return a recipe with all keys. Raises ``ConfigError`` for an unknown key or an invalid value, which it names."""
    if unknown := [key for key in given if key not in DEFAULTS]:
        raise ConfigError(f"expected the keys {', '.join(DEFAULTS)} in a recipe, found {unknown[0]!r}")
    bins = given.get("bins", {})
    if not isinstance(bins, Mapping) or (unknown := [key for key in bins if key not in BINS]):
        found = unknown[0] if isinstance(bins, Mapping) else bins
        raise ConfigError(f"expected the keys {', '.join(BINS)} in recipe.bins, found {found!r}")
    recipe = {**DEFAULTS, **given, "bins": {**BINS, **bins}}
    drawn, size = size_of(recipe["drawn"], "recipe.drawn"), size_of(recipe["size"], "recipe.size")
    if drawn[0] < size[0] or drawn[1] < size[1]:
        raise ConfigError(f"expected recipe.drawn of {recipe['size']} or larger, found {recipe['drawn']}")
    count = recipe["bins"]["count"]
    if not isinstance(count, int) or not 2 <= count <= MAX_BINS:
        raise ConfigError(f"expected recipe.bins.count of 2 to {MAX_BINS}, found {count!r}")
    if recipe["bins"]["scale"] not in ("linear", "log"):
        raise ConfigError(f"expected recipe.bins.scale of linear, log, found {recipe['bins']['scale']!r}")
    for name, value in (
        ("radius_m", recipe["radius_m"]),
        *((f"bins.{key}", recipe["bins"][key]) for key in ("far_m", "gamma")),
    ):
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < float("inf"):
            raise ConfigError(f"expected recipe.{name} above 0, found {value!r}")
    _splat(recipe["splat"])
    return recipe


def size_of(text: Any, name: str) -> tuple[int, int]:
    """Return height and width of a text such as ``256x448``. Raises ``ConfigError``."""
    parts = text.split("x") if isinstance(text, str) else []
    if len(parts) != 2 or not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise ConfigError(f"expected {name} of HEIGHTxWIDTH, such as 256x448, found {text!r}")
    return int(parts[0]), int(parts[1])


def _splat(text: Any) -> list[tuple[float, int]]:
    try:
        pairs = [entry.split(":") for entry in text.split(",")]
        return [(float(depth), int(radius)) for depth, radius in pairs]
    except (AttributeError, ValueError):
        raise ConfigError(f"expected recipe.splat of Z:R,.., such as 15:1,100:0, found {text!r}") from None


def _comparable(key: str, value: Any) -> Any:
    if key == "splat":
        return _splat(value)
    if key == "bins":
        return {name: value[name] if isinstance(value[name], str) else float(value[name]) for name in BINS}
    return float(value) if isinstance(value, (int, float)) else value


def difference(expected: Mapping[str, Any], found: Mapping[str, Any]) -> str | None:
    """Return which key of two complete recipes differs, as ``expected .., found ..``; ``None`` if none does.

    ``drawn`` of an export at the cameras' own size is ``None``, which is not compared.
    """
    for key in DEFAULTS:
        if key == "drawn" and found[key] is None:
            continue
        if _comparable(key, expected[key]) != _comparable(key, found[key]):
            return f"expected maps with {key} {_text(expected[key])}, found {_text(found[key])}"
    return None


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def of_export(options: Mapping[str, Any], size: tuple[int, int]) -> dict[str, Any]:
    """Return the recipe of an export, from the options in its ``export.json`` and the size of its maps.

    ``drawn`` is ``None`` if the maps were rendered at the cameras' own sizes. Raises ``KeyError`` for a missing option.
    """
    text = f"{size[0]}x{size[1]}"
    drawn = options["size"]
    if drawn is None and options["out_size"] is None:
        drawn = text
    return {
        "drawn": drawn,
        "size": text,
        "splat": options["splat"],
        "radius_m": options["radius_m"],
        "color_filter": options["color_filter"],
        "bins": {**BINS, **options["depth_bins"]},
        "min_actor_points": options["min_actor_points"],
        "template_fit": options["template_fit"],
        "line_width": options["layout"]["line_width"],
        "map_layers": options["layout"]["map_layers"],
    }


def renderer_keywords(recipe: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of ``pskel.Renderer`` for a complete recipe."""
    return {
        "size": size_of(recipe["drawn"], "recipe.drawn"),
        "out_size": size_of(recipe["size"], "recipe.size"),
        "splat": recipe["splat"],
        "radius": float(recipe["radius_m"]),
        "color_filter": recipe["color_filter"],
        "depth_bins": recipe["bins"]["scale"],
        "far": float(recipe["bins"]["far_m"]),
        "min_actor_points": recipe["min_actor_points"],
        "template_fit": recipe["template_fit"],
        "line_width": recipe["line_width"],
        "map_layers": recipe["map_layers"],
    }


def depth_bins(depth_m: npt.NDArray[np.float32], bins: Mapping[str, Any]) -> npt.NDArray[np.int16]:
    """Return the bins of depths in meters, 1 to ``count``; 0 where empty (infinite, NaN, or not positive).

    Computed in ``float32`` step by step as the renderer does (docs/src/reference/maps.md), so that the bins are the
    same.
    """
    depth = np.asarray(depth_m, np.float32)
    empty = ~(np.isfinite(depth) & (depth > 0))
    far, count = np.float32(bins["far_m"]), int(bins["count"])
    within = np.minimum(np.where(empty, np.float32(0), depth), far)
    if bins["scale"] == "linear":
        found = (within / (far + _EPSILON) * np.float32(count - 1)).astype(np.int32) + 1
    else:
        found = _log_bins(within, far, count, np.float32(bins["gamma"]))
    return np.where(empty, 0, found).astype(np.int16)


def _log_bins(depth: npt.NDArray[np.float32], far: np.float32, count: int, gamma: np.float32) -> npt.NDArray[np.int32]:
    def ln_1p(x: Any) -> Any:
        return np.log1p(np.asarray(x, np.float64)).astype(np.float32)

    near = np.float32(0.6) * far
    near_bins = min(round(0.85 * count), count - 1)
    part = ln_1p(depth) / (ln_1p(near) + _EPSILON)
    part = part if gamma == 1 else part**gamma
    within = (part * np.float32(near_bins - 1)).astype(np.int32) + 1
    beyond = ln_1p(np.maximum(depth - near, np.float32(0))) / (ln_1p(far - near) + _EPSILON)
    behind = (beyond * np.float32(count - near_bins - 1)).astype(np.int32) + 1 + near_bins
    bins: npt.NDArray[np.int32] = np.where(depth <= near, within, behind)
    return bins
