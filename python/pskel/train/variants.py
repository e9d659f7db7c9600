"""Trainings of the paper's ablation by name: ``python -m pskel.train --variant NAME``.

Each variant adds something to the one before; the last two change the bins of depth instead. ``pskel protocol`` compares
their weights: ``pskel protocol ablation --variant NAME=FILE``, or ``--generator .. --without`` with ``dropped`` of a variant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from .errors import ConfigError

__all__ = ["VARIANTS", "Variant", "settings_of"]


class Variant(NamedTuple):
    """A training."""

    title: str
    dropped: tuple[str, ...]
    """Conditions that the network never gets, which ``pskel protocol --without`` drops too."""
    settings: Mapping[str, Mapping[str, Any]]
    """Values of the configuration by network, where ``small`` and ``pas-image`` know the variant."""


_SEEN = {"pas-image.previous_share": 0.5, "pas-image.single_frames": 0.1}
_CLEAN = {**_SEEN, "pas-image.previous_from": 0, "pas-image.previous_to": 0, "pas-image.history_level": 0}
_NOISED = {**_SEEN, "pas-image.previous_from": 50, "pas-image.previous_to": 200, "pas-image.history_level": 100}
_ALONE = {"pas-image.previous_share": 0.0, "pas-image.single_frames": 1.0}
_PLAIN = {"data.augment": False}
_DEGRADED = {"data.augment": True, "data.variants": 5}
"""Of five variants of a log the first is as recorded: 80 % have degraded assets, as in the paper."""


def _without(network: str, *dropped: str) -> dict[str, float]:
    return {f"{network}.drop_{condition}": 1.0 for condition in dropped}


def _image(*parts: Mapping[str, Any], dropped: tuple[str, ...] = ()) -> dict[str, Any]:
    joined: dict[str, Any] = {}
    for part in (*parts, _without("pas-image", *dropped)):
        joined.update(part)
    return joined


def _small(errors: float, augment: Mapping[str, Any], dropped: tuple[str, ...] = ()) -> dict[str, Any]:
    return {"small.errors": errors, **augment, **_without("small", *dropped)}


_POINTS = ("color", "depth")

VARIANTS: Mapping[str, Variant] = {
    "layout": Variant("layout", _POINTS, {"pas-image": _image(_ALONE, _PLAIN, dropped=_POINTS)}),
    "previous_clean": Variant(
        "layout and previous frame",
        _POINTS,
        {"pas-image": _image(_CLEAN, _PLAIN, dropped=_POINTS), "small": _small(0.0, _PLAIN, _POINTS)},
    ),
    "previous_noised": Variant(
        "layout and noisy previous frame",
        _POINTS,
        {"pas-image": _image(_NOISED, _PLAIN, dropped=_POINTS), "small": _small(0.8, _PLAIN, _POINTS)},
    ),
    "color": Variant(
        "layout, noisy previous frame and color",
        ("depth",),
        {"pas-image": _image(_NOISED, _PLAIN, dropped=("depth",)), "small": _small(0.8, _PLAIN, ("depth",))},
    ),
    "depth": Variant(
        "layout, noisy previous frame, color and depth",
        (),
        {"pas-image": _image(_NOISED, _PLAIN), "small": _small(0.8, _PLAIN)},
    ),
    "augmentation": Variant(
        "the same with degraded assets",
        (),
        {"pas-image": _image(_NOISED, _DEGRADED), "small": _small(0.8, _DEGRADED)},
    ),
    "relative_depth": Variant(
        "the same with finer bins of depth near the camera",
        (),
        {
            "pas-image": _image(_NOISED, _DEGRADED, {"pas-image.bin_scale": "log"}),
            "small": {**_small(0.8, _DEGRADED), "small.recipe.bins.scale": "log"},
        },
    ),
    "metric_depth": Variant(
        "the same with bins of depth of equal width",
        (),
        {
            "pas-image": _image(_NOISED, _DEGRADED, {"pas-image.bin_scale": "linear"}),
            "small": {**_small(0.8, _DEGRADED), "small.recipe.bins.scale": "linear"},
        },
    ),
}


def settings_of(name: str, network: object) -> Mapping[str, Any]:
    """Return the values of a variant, by key of the configuration. Raises ``ConfigError`` for another name or network."""
    known = [each for each, variant in VARIANTS.items() if network in variant.settings]
    if not known:
        raise ConfigError(f"expected network small or pas-image with --variant, found {network}")
    if name not in known:
        raise ConfigError(f"expected --variant of {', '.join(known)} for network {network}, found {name!r}")
    return VARIANTS[name].settings[str(network)]
