"""Scores and pictures of held-out clips."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from .config import Config
from .data.reader import ClipSet, Skip
from .data.sources import Data
from .outputs import stacked
from .parallel import Processes
from .players import autocast
from .task import Task

__all__ = ["Validation", "validate"]


class Validation(NamedTuple):
    """Result of a validation: mean scores, and a picture ``uint8 [3, H, W]`` in the main process."""

    scores: dict[str, float]
    picture: Tensor | None
    skipped: list[str]
    """Why clips were left out in this process."""


def spread(clip_sets: Sequence[ClipSet], count: int) -> list[tuple[ClipSet, int]]:
    """Return up to ``count`` clips, evenly spaced over all of them."""
    clips = [(clip_set, index) for clip_set in clip_sets for index in range(len(clip_set))]
    count = min(count, len(clips))
    return [clips[(2 * i + 1) * len(clips) // (2 * count)] for i in range(count)]


def validate(
    task: Task,
    modules: Mapping[str, nn.Module],
    data: Data,
    config: Config,
    processes: Processes,
) -> Validation:
    """Score held-out clips, or clips of the training if there are none. Processes share the clips unless modules are
    sharded."""
    clips = spread(data.validation or data.train, config.data.validation_clips)
    is_sharded = config.train.shard == "fsdp"
    found: list[dict[str, float]] = []
    pictures: list[Tensor] = []
    skipped: list[str] = []
    with torch.no_grad(), autocast(config.train, processes.device):
        for number, (clip_set, index) in enumerate(clips):
            is_mine = is_sharded or number % processes.count == processes.rank
            is_shown = number < config.data.validation_pictures and (is_sharded or processes.is_main)
            if not (is_mine or is_shown):
                continue
            try:
                clip = clip_set.clip(index)
            except Skip as reason:
                skipped.append(str(reason))
                continue
            if is_mine:
                found.append(task.scores(clip, modules))
            if is_shown:
                pictures.append(task.pictures(clip, modules))
    if not is_sharded:
        found = [scores for of_process in processes.gather(found) for scores in of_process]
    names = {name: None for scores in found for name in scores}
    values = {name: [scores[name] for scores in found if name in scores] for name in names}
    means = {name: math.fsum(each) / len(each) for name, each in values.items()}
    return Validation(means, stacked(pictures) if processes.is_main else None, skipped)
