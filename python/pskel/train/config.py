"""The configuration of a training: a TOML or JSON file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from .errors import ConfigError, first_line
from .variants import settings_of

__all__ = ["Config", "DataOptions", "TrainOptions", "read_document", "with_settings"]

NETWORKS = ("small", "pas", "pas-image")
SCHEDULES = ("constant", "cosine")
PRECISIONS = ("f32", "bf16")
SHARDS = ("none", "fsdp")
OPTIMIZERS = ("adamw", "adamw8bit")


@dataclass(frozen=True)
class TrainOptions:
    """The table ``[train]``."""

    steps: int = 10_000
    batch: int = 1
    """Clips per process in a batch."""
    accumulate: int = 1
    """Batches per process in a step."""
    learning_rate: float = 1e-4
    warmup: int = 0
    """Steps in which the rate rises linearly."""
    schedule: str = "constant"
    """``constant``, or ``cosine``: from the rate to ``final_rate`` times the rate in the last step."""
    final_rate: float = 0.1
    betas: tuple[float, float] = (0.9, 0.999)
    epsilon: float = 1e-8
    weight_decay: float = 0.01
    clip_norm: float = 0.0
    """Maximum norm of the gradients of a player; 0 does not clip."""
    ema: float = 0.0
    """Decay of the exponential moving average of the weights; 0 has none."""
    precision: str = "f32"
    """``f32``, or ``bf16``: autocast with weights and moments in f32."""
    seed: int = 0
    checkpoint: int = 1000
    """Steps between checkpoints."""
    validate: int = 1000
    """Steps between validations; 0 has none."""
    workers: int = 0
    """Processes that read clips, per process of the training."""
    shard: str = "none"
    """``none`` (every process has all weights), or ``fsdp``."""
    optimizer: str = "adamw"
    """``adamw``, or ``adamw8bit``: moments of 8 bits."""

    def __post_init__(self) -> None:
        _expect_at_least(self, "train", 1, "steps", "batch", "accumulate", "checkpoint")
        _expect_at_least(self, "train", 0, "warmup", "seed", "validate", "workers")
        _expect_at_least(self, "train", 0, "learning_rate", "final_rate", "weight_decay", "clip_norm", "ema", "epsilon")
        _expect_one_of("train.schedule", self.schedule, SCHEDULES)
        _expect_one_of("train.precision", self.precision, PRECISIONS)
        _expect_one_of("train.shard", self.shard, SHARDS)
        _expect_one_of("train.optimizer", self.optimizer, OPTIMIZERS)
        for name, value in (("ema", self.ema), ("betas", self.betas[0]), ("betas", self.betas[1])):
            if not 0 <= value < 1:
                raise ConfigError(f"expected train.{name} of 0 to below 1, found {value}")


@dataclass(frozen=True)
class DataOptions:
    """The table ``[data]``: which clips are taken."""

    frames: int = 1
    """Frames of a clip."""
    every: int | None = None
    """A clip has every N-th frame of a log."""
    hz: float | None = None
    """In place of ``every``: rate of the frames, which divides the log's rate. Clips across gaps are left out."""
    stride: int = 1
    """Frames from the beginning of a clip to that of the next one."""
    cameras: tuple[str, ...] | None = None
    """Channels, and their order. By default all of a log."""
    weights: tuple[float, ...] | Mapping[str, float] | None = None
    """How often clips are drawn: a number for each --data, or numbers by pattern of log names (others have 1). Without
    it, each clip comes once per epoch."""
    hold_out: int = 0
    """Frames N-1, 2N-1 .. of each log are for validation."""
    hold_out_logs: tuple[str, ...] = ()
    """Patterns of log names that are for validation."""
    validation_clips: int = 8
    validation_pictures: int = 4
    recipe: Mapping[str, Any] | None = None
    """How maps are rendered: keys of the denoiser protocol, whose defaults fill missing ones."""
    captions: str | None = None
    """JSON file of captions of logs that are rendered."""
    skeletons: str | None = None
    """Folder of skeletons of logs that are rendered, each named after its log; missing ones are built."""
    cache: str | None = None
    """Folder in which rendered clips are stored, before the first step."""
    pas_cache: str | None = None
    """Folder of an export in the layout pas-cache, which has the maps of the logs."""
    variants: int = 1
    """Variants of each rendered log: the first as recorded, the others with degraded assets, and of towns with a moved
    ego."""
    augment: bool = True
    """Whether assets of the variants are degraded."""
    rasterizer: str = "auto"

    def __post_init__(self) -> None:
        _expect_at_least(self, "data", 1, "frames", "stride", "variants")
        _expect_at_least(self, "data", 0, "validation_clips", "validation_pictures")
        if self.every is not None and self.hz is not None:
            raise ConfigError(f"expected data.every or data.hz, found both: {self.every} and {self.hz}")
        if self.every is not None and self.every < 1:
            raise ConfigError(f"expected data.every of 1 or more, found {self.every}")
        if self.hz is not None and not (math.isfinite(self.hz) and self.hz > 0):
            raise ConfigError(f"expected data.hz above 0, found {self.hz}")
        if self.hold_out < 0 or self.hold_out == 1:
            raise ConfigError(f"expected data.hold_out of 0, or of 2 or more, found {self.hold_out}")
        if self.cameras is not None and (not self.cameras or len(set(self.cameras)) != len(self.cameras)):
            raise ConfigError(f"expected data.cameras with different names, found {', '.join(self.cameras) or 'none'}")
        weights = self.weights.values() if isinstance(self.weights, Mapping) else self.weights or ()
        if wrong := [weight for weight in weights if not (math.isfinite(weight) and weight >= 0)]:
            raise ConfigError(f"expected data.weights of 0 or more, found {wrong[0]}")


@dataclass(frozen=True)
class Config:
    """A whole configuration."""

    network: str
    """``small``, ``pas``, ``pas-image``, or ``MODULE:FUNCTION`` that creates a task."""
    train: TrainOptions = field(default_factory=TrainOptions)
    data: DataOptions = field(default_factory=DataOptions)
    options: Mapping[str, Any] = field(default_factory=dict)
    """The network's own table: ``[small]``, ``[pas]``, ``[pas-image]``, or ``[options]``."""

    @classmethod
    def read(cls, path: str | os.PathLike[str], settings: Sequence[str] = (), variant: str | None = None) -> Config:
        """Read a file, and change it by a name in ``VARIANTS``, then by texts ``KEY=VALUE``.

        Raises ``ConfigError``, which names the file."""
        try:
            document = read_document(path)
            of_variant = {} if variant is None else settings_of(variant, document.get("network"))
            changes = [f"{key}={json.dumps(value)}" for key, value in of_variant.items()]
            return cls.parse(with_settings(document, [*changes, *settings]))
        except ConfigError as error:
            raise ConfigError(f"{error}: {os.fspath(path)}") from error

    @classmethod
    def parse(cls, document: Mapping[str, Any]) -> Config:
        """Convert a parsed document. Raises ``ConfigError``, which names the key."""
        network = document.get("network")
        if not isinstance(network, str) or not (network in NETWORKS or ":" in network):
            raise ConfigError(f"expected network of {', '.join(NETWORKS)} or MODULE:FUNCTION, found {_shown(network)}")
        table = "options" if ":" in network else network
        known = ["network", "train", "data", table]
        if unknown := [key for key in document if key not in known]:
            raise ConfigError(f"expected the keys {', '.join(known)}, found {unknown[0]!r}")
        tables = {name: document.get(name, {}) for name in known[1:]}
        if wrong := [name for name, value in tables.items() if not isinstance(value, Mapping)]:
            raise ConfigError(f"expected a table [{wrong[0]}], found {_shown(tables[wrong[0]])}")
        train, data = _filled(TrainOptions, tables["train"], "train"), _filled(DataOptions, tables["data"], "data")
        return cls(network, train, data, dict(tables[table]))

    def to_json(self) -> dict[str, Any]:
        """Return a form of which JSON is the same after reading."""
        value: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return value


def read_document(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file, or a JSON file by its suffix. Raises ``ConfigError`` for other content."""
    source = Path(path)
    try:
        content = source.read_bytes()
        document = json.loads(content) if source.suffix == ".json" else _toml(content.decode())
    except OSError as error:
        raise ConfigError(f"the configuration cannot be read: {error.strerror}") from error
    except ValueError as error:
        kind = "JSON" if source.suffix == ".json" else "TOML"
        raise ConfigError(f"expected {kind}, found {first_line(error)}") from error
    if not isinstance(document, dict):
        raise ConfigError(f"expected a JSON object, found {_shown(document)}")
    return document


def with_settings(document: Mapping[str, Any], settings: Sequence[str]) -> dict[str, Any]:
    """Return a document with values set by texts such as ``train.steps=100``; values are TOML, or else texts."""
    changed: dict[str, Any] = json.loads(json.dumps(document, default=str))
    for setting in settings:
        key, equals, text = setting.partition("=")
        path = [part.strip() for part in key.split(".")]
        if not equals or not all(path):
            raise ConfigError(f"expected --set KEY=VALUE, such as train.steps=100, found {setting!r}")
        table = changed
        for part in path[:-1]:
            table = table.setdefault(part, {})
            if not isinstance(table, dict):
                raise ConfigError(f"expected --set of a key in a table, found {key}")
        table[path[-1]] = _value(text.strip())
    return changed


def _toml(text: str) -> Any:
    try:
        import tomllib
    except ImportError:  # Python 3.10
        raise ConfigError("TOML needs Python 3.11: write the configuration as JSON, in a file named .json") from None
    return tomllib.loads(text)


def _value(text: str) -> Any:
    """Return the value of a text: JSON, then TOML, else the text itself."""
    try:
        return json.loads(text)
    except ValueError:
        pass
    try:
        return _toml(f"value = {text}")["value"]
    except (ValueError, ConfigError):
        return text


_Options = TypeVar("_Options", TrainOptions, DataOptions)


def _filled(kind: type[_Options], table: Mapping[str, Any], name: str) -> _Options:
    hints = get_type_hints(kind)
    known = [each.name for each in fields(kind)]
    if unknown := [key for key in table if key not in known]:
        raise ConfigError(f"expected the keys {', '.join(known)} in [{name}], found {unknown[0]!r}")
    return kind(**{key: _converted(hints[key], value, f"{name}.{key}") for key, value in table.items()})


def _converted(hint: Any, value: Any, name: str) -> Any:
    """Convert a value of TOML or JSON to the type of a field."""
    text = str(hint)
    if hint is float or text.startswith("float |"):
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return float(value)
        raise ConfigError(f"expected a number for {name}, found {_shown(value)}")
    if hint in (int, str, bool) or text in ("int | None", "str | None"):
        base = hint if isinstance(hint, type) else {"int": int, "str": str}[text.split()[0]]
        if type(value) is base:
            return value
        kind = {int: "a whole number", str: "a text", bool: "true or false"}[base]
        raise ConfigError(f"expected {kind} for {name}, found {_shown(value)}")
    if isinstance(value, Mapping) and "Mapping" in text:
        if "Mapping[str, float]" in text:
            return {key: _converted(float, each, f"{name}.{key}") for key, each in value.items()}
        return dict(value)
    if isinstance(value, list) and "tuple" in text:
        items = tuple(_converted(str if "tuple[str" in text else float, each, name) for each in value)
        if "..." in text or len(items) == 2:
            return items
        raise ConfigError(f"expected two numbers for {name}, found {_shown(value)}")
    expected = (
        "a list" if "tuple" in text and "Mapping" not in text else "a list or table" if "tuple" in text else "a table"
    )
    raise ConfigError(f"expected {expected} for {name}, found {_shown(value)}")


def _expect_at_least(options: Any, table: str, least: int, *names: str) -> None:
    for name in names:
        value = getattr(options, name)
        if not (math.isfinite(value) and value >= least):
            raise ConfigError(f"expected {table}.{name} of {least} or more, found {value}")


def _expect_one_of(name: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise ConfigError(f"expected {name} of {', '.join(known)}, found {value!r}")


def _shown(value: Any) -> str:
    return "none" if value is None else json.dumps(value, default=str)[:60]
