"""Batches of a training, drawn in worker processes."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from typing import Any, NamedTuple

from torch.utils.data import DataLoader, Dataset

from .clip import Clip
from .config import TrainOptions
from .data.sampling import Sampler
from .errors import DataError, TrainError
from .parallel import Processes
from .task import Task

__all__ = ["Batch", "Loader", "statistics_clips"]


class Batch(NamedTuple):
    """What ``Task.draw`` returned, the clips it was drawn from, and why others were left out."""

    content: Any
    clips: tuple[str, ...]
    skipped: tuple[str, ...]


class _Failure(NamedTuple):
    """An error of a worker process."""

    text: str


class _Batches(Dataset[Any]):
    """Batches of a process by number: step times ``accumulate``, plus the number in the step."""

    def __init__(self, task: Task, sampler: Sampler, options: TrainOptions, processes: Processes) -> None:
        self._task = task
        self._sampler = sampler
        self._options = options
        self._processes = processes

    def __getitem__(self, number: int) -> Batch | _Failure:
        options = self._options
        step, place = divmod(number, options.accumulate)
        # Numbered over processes and accumulation: two processes have the same clips as two batches of one.
        of_step = self._processes.rank * options.accumulate + place
        batches = self._processes.count * options.accumulate
        first = (step * batches + of_step) * options.batch
        try:
            drawn = [self._sampler.draw(first + i) for i in range(options.batch)]
            content = self._task.draw([each.clip for each in drawn], step, options.seed, of_step)
        except TrainError as error:
            return _Failure(str(error))
        except MemoryError:
            return _Failure("main memory is not enough for a batch: reduce train.workers, train.batch or data.frames")
        skipped = tuple(text for each in drawn for text in each.skipped)
        return Batch(content, tuple(each.name for each in drawn), skipped)


class _Statistics(Dataset[Any]):
    """Clips for ``Task.prepare`` by number."""

    def __init__(self, sampler: Sampler) -> None:
        self._sampler = sampler

    def __getitem__(self, number: int) -> Clip | _Failure:
        try:
            return self._sampler.statistic(number).clip
        except TrainError as error:
            return _Failure(str(error))


class _Numbers:
    """Numbers from the first to the last one, or without an end."""

    def __init__(self, first: int, end: int | None) -> None:
        self._first = first
        self._end = end

    def __iter__(self) -> Iterator[int]:
        number = self._first
        while self._end is None or number < self._end:
            yield number
            number += 1


class Loader:
    """Reads the batches of the steps from ``first`` on. Workers are forked at once."""

    def __init__(
        self, task: Task, sampler: Sampler, options: TrainOptions, processes: Processes, first: int, steps: int
    ) -> None:
        self._accumulate = options.accumulate
        numbers = _Numbers(first * options.accumulate, steps * options.accumulate)
        dataset = _Batches(task, sampler, options, processes)
        pin = processes.device.type == "cuda"
        self._batches: Generator[Any, None, None] = _loaded(dataset, numbers, options.workers, pin)

    def step(self) -> list[Batch]:
        """Return the batches of the next step. Raises ``DataError``."""
        return [_checked(next(self._batches)) for _ in range(self._accumulate)]

    def close(self) -> None:
        """End the workers."""
        self._batches.close()


@contextmanager
def statistics_clips(sampler: Sampler, options: TrainOptions) -> Iterator[Iterator[Clip]]:
    """Give clips without an end for a while, read by workers."""
    with closing(_loaded(_Statistics(sampler), _Numbers(0, None), options.workers, False)) as clips:
        yield (_checked(clip) for clip in clips)


def _loaded(dataset: Dataset[Any], numbers: _Numbers, workers: int, pin: bool) -> Generator[Any, None, None]:
    loader: Any = DataLoader(
        dataset,
        batch_size=None,
        sampler=numbers,
        num_workers=workers,
        pin_memory=pin,
        # Forked workers take the task as it is. They open devices of their own, and this process has opened none yet.
        multiprocessing_context="fork" if workers else None,
        collate_fn=_unchanged,
    )
    return _guarded(iter(loader))


def _guarded(batches: Any) -> Generator[Any, None, None]:
    """Yield batches, and end the workers at last."""
    try:
        yield from batches
    except (ConnectionError, EOFError, FileNotFoundError) as error:
        if str(error).startswith("Caught"):  # of the code in a worker
            raise
        raise DataError("a process that reads clips was killed, out of memory? reduce train.workers") from error
    finally:
        shutdown = getattr(batches, "_shutdown_workers", None)
        if shutdown is not None:
            shutdown()


def _unchanged(value: Any) -> Any:
    return value


def _checked(value: Any) -> Any:
    if isinstance(value, _Failure):
        raise DataError(value.text)
    return value
