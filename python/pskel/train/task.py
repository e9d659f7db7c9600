"""What a network brings to its training."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import torch
from torch import Tensor, nn

from .errors import ConfigError, first_line

if TYPE_CHECKING:
    from .clip import Clip
    from .config import Config, TrainOptions

__all__ = ["LOGGED", "Player", "Task", "create_task", "recipe_of"]


LOGGED = ("loss", "gradient_norm", "learning_rate")
"""Numbers of a player that the harness logs."""


class Player(NamedTuple):
    """A module that is trained, with a loss and an optimizer of its own."""

    name: str
    """For instance ``network`` or ``discriminator``."""
    module: nn.Module
    groups: list[dict[str, Any]]
    """Parameter groups of the optimizer: ``params``, and overrides of ``lr``, ``betas``, ``eps`` and ``weight_decay``.
    With ``"schedule": "constant"`` the rate of a group is its ``lr`` in every step."""
    start: int = 0
    """First step in which it is trained."""


class Task(Protocol):
    """A network and its loss. The first player is the network: the harness keeps its exponential moving average.

    ``pskel.models.NETWORK.task`` has a function ``task(options: Mapping, train: TrainOptions) -> Task`` that creates
    it, with the network's own table of the configuration; random numbers of its initial weights come from PyTorch's
    default generator. A task whose loss leaves trained parameters without a gradient in some steps has an attribute
    ``unused_parameters = True``. The module may also have a function ``recipe(options: Mapping) -> Mapping``: how the
    maps of the network are rendered, if ``[data.recipe]`` does not say.
    """

    @property
    def players(self) -> Sequence[Player]:
        """Everything that is trained, in the order of the losses."""

    def prepare(self, clips: Iterator[Clip]) -> None:
        """Take statistics of the data, once before the first step; ``clips`` does not end."""

    def draw(self, clips: Sequence[Clip], step: int, seed: int, rank: int) -> Any:
        """Return a batch on the CPU: augmentation, noise, levels, dropouts.

        Depends on its arguments alone. ``rank`` is the number of the batch in its step, over processes and
        accumulation. Runs in processes that were forked before the first step, so it must not use the modules'
        parameters.
        """

    def loss(
        self, player: str, batch: Any, modules: Mapping[str, nn.Module], device: torch.device
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a player, and numbers to log, named other than ``LOGGED``.

        ``batch`` is what ``draw`` returned, with the tensors in its tuples, lists and dictionaries on the device. Runs
        under autocast. The parameters of the other players need no gradients meanwhile. PyTorch's default generator is
        seeded by step and batch. With ``shard = "fsdp"``, modules must be called, not their parts.
        """

    def pictures(self, clip: Clip, modules: Mapping[str, nn.Module]) -> Tensor:
        """Return pictures of a held-out clip for people, ``uint8 [rows, 3, H, W]``."""

    def scores(self, clip: Clip, modules: Mapping[str, nn.Module]) -> dict[str, float]:
        """Return scores of a held-out clip, such as ``{"psnr_db": 21.0}``."""

    def weights(self, modules: Mapping[str, nn.Module]) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Return what inference loads: tensors, and texts of the header."""

    def state(self) -> dict[str, Any]:
        """Return everything besides modules that a checkpoint needs, such as statistics."""

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore ``state``."""


def _module(network: str) -> Any:
    name = network.partition(":")[0] if ":" in network else f"pskel.models.{network.replace('-', '_')}.task"
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigError(f"network {network!r} cannot be loaded: {first_line(error)}") from error


def create_task(config: Config) -> Task:
    """Create the task of a configuration: ``pskel.models.NETWORK.task.task``, or ``MODULE:FUNCTION``.

    Raises ``ConfigError`` if it cannot be loaded or refuses its options.
    """
    function = config.network.partition(":")[2] or "task"
    create: Callable[[Mapping[str, Any], TrainOptions], Task] | None = getattr(_module(config.network), function, None)
    if create is None:
        raise ConfigError(f"network {config.network!r} has no function {function!r}")
    try:
        task = create(config.options, config.train)
    except (ValueError, TypeError, OSError, ImportError) as error:
        raise ConfigError(f"network {config.network!r}: {first_line(error)}") from error
    names = [player.name for player in task.players]
    if not names or len(set(names)) != len(names):
        raise ConfigError(
            f"expected players with different names, found {', '.join(names) or 'none'}: {config.network}"
        )
    return task


def recipe_of(config: Config) -> Mapping[str, Any] | None:
    """Return the recipe that the configuration asks for: its own, else the network's, else none."""
    if config.data.recipe is not None:
        return config.data.recipe
    function = getattr(_module(config.network), "recipe", None)
    if function is None:
        return None
    try:
        recipe: Mapping[str, Any] = function(config.options)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"network {config.network!r}: {first_line(error)}") from error
    return recipe
