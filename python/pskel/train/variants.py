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

    dropped: tuple[str, ...]
    """Conditions that the network never gets, which ``pskel protocol --without`` drops too."""
    settings: Mapping[str, Mapping[str, Any]]
    """Other values of the configuration by network, where ``small`` and ``pas-image`` know the variant."""


_ALONE = {"pas-image.previous_share": 0.0, "pas-image.single_frames": 1.0}
_SEEN = {"pas-image.previous_share": 0.5, "pas-image.single_frames": 0.1}
_CLEAN = {**_SEEN, "pas-image.previous_from": 0, "pas-image.previous_to": 0, "pas-image.history_level": 0}
_NOISED = {**_SEEN, "pas-image.previous_from": 50, "pas-image.previous_to": 200, "pas-image.history_level": 100}
_PLAIN = {"data.augment": False}
_DEGRADED = {"data.augment": True, "data.variants": 5}
"""Of five variants of a log the first is as recorded: 80 % have degraded assets, as in the paper."""

_NOISED_PLAIN = {"pas-image": {**_NOISED, **_PLAIN}, "small": {"small.errors": 0.8, **_PLAIN}}
_IMAGE, _SMALL = {**_NOISED, **_DEGRADED}, {"small.errors": 0.8, **_DEGRADED}


def _scaled(scale: str) -> Variant:
    bins = {"pas-image.bin_scale": scale}, {"small.recipe.bins.scale": scale}
    return Variant((), {"pas-image": {**_IMAGE, **bins[0]}, "small": {**_SMALL, **bins[1]}})


VARIANTS: Mapping[str, Variant] = {
    "layout": Variant(("color", "depth"), {"pas-image": {**_ALONE, **_PLAIN}}),
    "previous_clean": Variant(
        ("color", "depth"), {"pas-image": {**_CLEAN, **_PLAIN}, "small": {"small.errors": 0.0, **_PLAIN}}
    ),
    "previous_noised": Variant(("color", "depth"), _NOISED_PLAIN),
    "color": Variant(("depth",), _NOISED_PLAIN),
    "depth": Variant((), _NOISED_PLAIN),
    "augmentation": Variant((), {"pas-image": _IMAGE, "small": _SMALL}),
    "relative_depth": _scaled("log"),
    "metric_depth": _scaled("linear"),
}


def settings_of(name: str, network: object) -> Mapping[str, Any]:
    """Return the values of a variant, by key of the configuration. Raises ``ConfigError`` for another name or network."""
    known = [each for each, variant in VARIANTS.items() if network in variant.settings]
    if not known:
        raise ConfigError(f"expected network small or pas-image with --variant, found {network}")
    if name not in known:
        raise ConfigError(f"expected --variant of {', '.join(known)} for network {network}, found {name!r}")
    variant = VARIANTS[name]
    return {**variant.settings[str(network)], **{f"{network}.drop_{each}": 1.0 for each in variant.dropped}}
