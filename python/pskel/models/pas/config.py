"""Configuration of the network, in the keys of the published training configurations."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

__all__ = ["AdapterConfig", "Config", "ID_CHANNELS"]

ID_CHANNELS = 256
"""Channels of the sinusoidal embedding for each number of ``added_time_ids``."""


def _expect_positive(config: Config | AdapterConfig) -> None:
    for name, value in vars(config).items():
        if type(value) is int and value < 1:
            raise ValueError(f"expected {name} of at least 1, found {value}")


@dataclass(frozen=True)
class AdapterConfig:
    """Adapter of condition maps: one residual per block, of its ``channels``."""

    in_channels: int
    channels: tuple[int, ...] = (1536,) * 6
    is_downblocks: tuple[bool, ...] = (True,) + (False,) * 5
    num_res_blocks: int = 2
    downscale_factor: int = 8

    FIXED: ClassVar[Mapping[str, Any]] = {"use_zero_convs": True}
    IGNORED: ClassVar[frozenset[str]] = frozenset()

    def __post_init__(self) -> None:
        _expect_positive(self)
        if len(self.is_downblocks) != len(self.channels):
            raise ValueError(f"expected is_downblocks for {len(self.channels)} blocks, found {len(self.is_downblocks)}")
        if any(self.is_downblocks[1:]):
            raise ValueError("expected is_downblocks in the first block alone, found a later one")


@dataclass(frozen=True)
class Config:
    """Sizes of the network. The defaults match the published nuScenes and nuPlan checkpoints."""

    num_layers: int = 24
    num_attention_heads: int = 24
    attention_head_dim: int = 64
    dual_attention_layers: tuple[int, ...] = tuple(range(13))
    crossview_block_layers: tuple[int, ...] = (1, 5, 9, 13, 17, 21)
    temporal_block_layers: tuple[int, ...] = (2, 3, 6, 7, 10, 11, 14, 15, 18, 19, 22, 23)
    in_channels: int = 16
    out_channels: int = 16
    patch_size: int = 2
    sample_size: int = 128
    pos_embed_max_size: int = 384
    joint_attention_dim: int = 4096
    caption_projection_dim: int = 1536
    pooled_projection_dim: int = 2048
    projection_class_embeddings_input_dim: int = 3328
    merge_factor: float = 2.0
    condition_image_adapter_config: AdapterConfig = AdapterConfig(in_channels=6)
    condition_pc_adapter_config: AdapterConfig = AdapterConfig(in_channels=20)

    FIXED: ClassVar[Mapping[str, Any]] = {
        "qk_norm": "rms_norm",
        "qk_norm_on_additional_modules": "rms_norm",
        "enable_crossview": True,
        "enable_temporal": True,
        "crossview_attention_type": "rowwise",
        "temporal_attention_type": "pointwise",
        "perspective_modeling_type": "implicit",
        "mixer_type": "AlphaBlender",
    }
    """Keys of which one value is implemented."""
    IGNORED: ClassVar[frozenset[str]] = frozenset({"crossview_gradient_checkpointing", "temporal_gradient_checkpointing"})
    """Keys that affect the authors' training alone."""

    def __post_init__(self) -> None:
        _expect_positive(self)
        if self.caption_projection_dim != self.inner_dim:
            raise ValueError(f"expected caption_projection_dim {self.inner_dim}, found {self.caption_projection_dim}")
        if self.projection_class_embeddings_input_dim % ID_CHANNELS:
            found = self.projection_class_embeddings_input_dim
            raise ValueError(f"expected projection_class_embeddings_input_dim of a multiple of {ID_CHANNELS}, found {found}")
        for name in ("dual_attention_layers", "crossview_block_layers", "temporal_block_layers"):
            layers = getattr(self, name)
            if list(layers) != sorted(set(layers) & set(range(self.num_layers))):
                raise ValueError(f"expected increasing {name} below {self.num_layers}, found {list(layers)}")
        for name, maps in (("condition_image_adapter_config", 6), ("condition_pc_adapter_config", 20)):
            adapter: AdapterConfig = getattr(self, name)
            if adapter.in_channels != maps:
                raise ValueError(f"expected {name}.in_channels {maps}, found {adapter.in_channels}")
            if set(adapter.channels) != {self.inner_dim}:
                raise ValueError(f"expected {name}.channels of {self.inner_dim} each, found {list(adapter.channels)}")
        image, points = len(self.condition_image_adapter_config.channels), len(self.condition_pc_adapter_config.channels)
        if image != points or image > self.num_layers:
            raise ValueError(f"expected adapters of equally many blocks, at most {self.num_layers}, found {image}, {points}")

    @property
    def inner_dim(self) -> int:
        """Channels of a token."""
        return self.num_attention_heads * self.attention_head_dim

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Config:
        """Read a JSON file; see ``parse``."""
        source = os.fspath(path)
        try:
            values = json.loads(Path(path).read_bytes())
        except ValueError as error:
            raise ValueError(f"expected JSON, found {error}: {source}") from error
        return cls.parse(values, source)

    @classmethod
    def parse(cls, values: Any, source: str = "configuration") -> Config:
        """Convert a parsed JSON object.

        Missing keys have the default value. Raises ``ValueError``, which names the key and ``source``, for an unknown key,
        a value of another type, and a variant of the network that is not implemented.
        """
        try:
            return _merged(cls(), values, "")
        except ValueError as error:
            raise ValueError(f"{error}: {source}") from None


_Config = TypeVar("_Config", Config, AdapterConfig)


def _merged(default: _Config, values: Any, prefix: str) -> _Config:
    """Override the fields of a configuration with a JSON object; ``prefix`` is the path of its keys."""
    if not isinstance(values, dict):
        raise ValueError(f"expected a JSON object{prefix and ' ' + prefix[:-1]}, found {json.dumps(values)[:40]}")
    known: dict[str, Any] = vars(default)
    changed = {}
    for key, value in values.items():
        name = prefix + key
        if key in known:
            changed[key] = _converted(known[key], value, name)
        elif key in default.FIXED:
            if value != default.FIXED[key]:
                raise ValueError(f"expected {name} {json.dumps(default.FIXED[key])}, found {json.dumps(value)[:40]}")
        elif key not in default.IGNORED:
            raise ValueError(f"expected keys of the network, found {name}")
    return replace(default, **changed)


def _converted(default: Any, value: Any, name: str) -> Any:
    """Convert a JSON value to the type of a default."""
    if isinstance(default, AdapterConfig):
        return _merged(default, value, f"{name}.")
    if isinstance(default, tuple):
        kind = type(default[0])
        if isinstance(value, list) and all(type(element) is kind for element in value):
            return tuple(value)
        raise ValueError(f"expected {name} of type list of {kind.__name__}, found {json.dumps(value)[:40]}")
    kinds = (int, float) if isinstance(default, float) else (type(default),)
    if type(value) not in kinds:
        raise ValueError(f"expected {name} of type {kinds[-1].__name__}, found {json.dumps(value)[:40]}")
    return value
