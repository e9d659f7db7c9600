"""Everything that ``--data`` names, as clips for training and for validation."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from ..config import DataOptions
from ..errors import ConfigError, DataError, TrainError, first_line
from ..parallel import Processes
from .captions import Captions, read_captions
from .drive import Drive, Track
from .exports import export_options
from .logs import is_town
from .pas_cache import PasCacheDrive, recipe_of_cache
from .recipe import complete, difference
from .recorded import RecordedDrive, recordings_in
from .rendered import RenderedDrive, RenderedSource, Variant, build_skeleton, record
from .shards import drives_of_shards

__all__ = ["Data", "open_data"]

Say = Callable[[str], None]


class Data(NamedTuple):
    """Clips of a training."""

    train: list[Track]
    shares: list[float] | None
    validation: list[Track]
    recipe: dict[str, Any]

    def to_json(self) -> list[Any]:
        """Return what a training depends on: logs, variants, and numbers of clips."""
        return [[track.drive.log, track.drive.variant, len(track)] for track in self.train]


class _Listed(NamedTuple):
    """A log that ``pskel.Log`` opens: its text and name."""

    text: str
    name: str


def open_data(
    specs: Sequence[str], options: DataOptions, recipe: Mapping[str, Any] | None, processes: Processes, say: Say
) -> Data:
    """Open everything that is named; logs are recorded first if there is a cache.

    A text of ``specs`` is a recorded clip, a folder of them, an export in the layout webdataset, or a log. Raises
    ``DataError`` for maps of another recipe, and ``ConfigError`` for options that do not fit.
    """
    if not specs:
        raise ConfigError("expected --data: a log, an export of pskel export, or recorded clips")
    with processes.agreed():
        wanted = None if recipe is None else complete(recipe)
        captions = read_captions(options.captions)
        stored = [_stored(spec) for spec in specs]
    by_spec: list[Sequence[Drive]] = []
    for spec, drives in zip(specs, stored):
        if drives is None:
            with processes.agreed():
                wanted = wanted or _recipe_of_logs(spec, options)
            drives = _logs(spec, options, wanted, captions, processes, say)
        by_spec.append(drives)
        with processes.agreed():
            wanted = _same_recipe(drives, wanted, say)
    assert wanted is not None
    with processes.agreed():
        return _chosen(by_spec, options, wanted, say)


def _same_recipe(drives: Sequence[Drive], wanted: dict[str, Any] | None, say: Say) -> dict[str, Any]:
    """Check that drives are of a recipe, by default that of the first; returns it."""
    for drive in drives:
        found = drive.recipe
        wanted = wanted or complete({key: value for key, value in found.items() if value is not None})
        if (text := difference(wanted, found)) is not None:
            raise DataError(f"{text}: {drive.source}")
        if found["drawn"] is None:
            say(f"{drive.source}: rendered at the cameras' own sizes, which are not compared with the recipe")
        drive.recipe = wanted
    assert wanted is not None
    return wanted


def _stored(spec: str) -> list[Drive] | None:
    """Open recordings or shards; ``None`` if the text is a log."""
    path = Path(spec)
    if path.suffix == ".safetensors":
        return [RecordedDrive(path)]
    if path.is_dir() and (path / "export.json").is_file():
        layout = export_options(path)["export_layout"]
        if layout == "webdataset":
            return drives_of_shards(path)
        if layout == "pas-cache":
            raise ConfigError(
                f"a pas-cache has maps alone: name it by data.pas_cache, and the logs by --data, found {spec}"
            )
        raise DataError(f"expected an export in the layout webdataset, found {layout}: {spec}")
    if path.is_dir() and (recordings := recordings_in(path)):
        return [RecordedDrive(each) for each in recordings]
    return None


def _recipe_of_logs(spec: str, options: DataOptions) -> dict[str, Any]:
    if options.pas_cache is None:
        raise ConfigError(
            f"expected a recipe in [data.recipe], which says how maps of logs are rendered, found none: {spec}"
        )
    return complete(
        {key: value for key, value in recipe_of_cache(Path(options.pas_cache)).items() if value is not None}
    )


def _logs(
    spec: str, options: DataOptions, recipe: dict[str, Any], captions: Captions, processes: Processes, say: Say
) -> list[Drive]:
    """Open logs. Skeletons are built and clips are recorded in rounds: each process does one, then all go on."""
    with processes.agreed():
        listed = list(_listed(spec))
        if options.pas_cache is not None:
            folder = Path(options.pas_cache)
            if (text := difference(recipe, recipe_of_cache(folder))) is not None:
                raise DataError(f"{text}: {folder}")
            return [PasCacheDrive(log.text, folder, recipe, captions=captions) for log in listed]
        skeletons = options.skeletons or (None if options.cache is None else f"{options.cache}/skeletons")
        if skeletons is None:
            raise ConfigError(f"expected data.skeletons or data.cache, folders for rendering logs, found none: {spec}")
    folder = Path(skeletons)
    builds = [log for log in listed if not (folder / log.name / "skeleton.json").is_file()]
    texts = [f"building the skeleton of {log.name}" for log in builds]
    _in_rounds(processes, [(build_skeleton, (log.text, str(folder / log.name))) for log in builds], texts, say)
    sources = [
        RenderedSource(
            log.text,
            folder / log.name,
            recipe,
            Variant.create(log.name, number, town=is_town(log.text), augment=options.augment),
            {name: caption for name, caption in captions.items() if name == log.name},
            options.rasterizer,
        )
        for log in listed
        for number in range(options.variants)
    ]
    if options.cache is not None:
        return _recorded([log.name for log in listed], sources, Path(options.cache), processes, say)
    with processes.agreed():
        return [RenderedDrive(source) for source in sources]


def _recorded(
    names: Sequence[str], sources: Sequence[RenderedSource], cache: Path, processes: Processes, say: Say
) -> list[Drive]:
    """Return the recordings of rendered logs, which are made if they do not exist."""
    of_sources = [names[number * len(names) // len(sources)] for number in range(len(sources))]
    paths = [cache / f"{name}-{source.change.label}.safetensors" for name, source in zip(of_sources, sources)]
    missing = [(source, path) for source, path in zip(sources, paths) if not path.is_file()]
    texts = [f"recording {path.name}" for _, path in missing]
    _in_rounds(processes, [(record, (source, path)) for source, path in missing], texts, say)
    found: list[Drive] = []
    with processes.agreed():
        for source, path in zip(sources, paths):
            recording = RecordedDrive(path)
            if recording.identity != source.identity():
                what = "a recording of this skeleton, recipe and captions"
                raise DataError(f"expected {what}, found another one; remove it, or choose another data.cache: {path}")
            found.append(recording)
    return found


def _listed(spec: str) -> Iterator[_Listed]:
    """Yield the logs of a text: a log, or all of a data set. Raises ``DataError`` if one cannot be opened."""
    import pskel

    if not hasattr(pskel, "Log"):
        path = Path(spec)
        what = "reading logs needs the compiled part of pskel, which this installation lacks"
        if path.exists():
            what = "expected recorded clips (.safetensors) or an export, found neither"
        raise DataError(f"{what}: {spec}")
    from pskel._export import defaults
    from pskel._pskel import Export

    try:
        keywords = {**defaults(), "layout": "frames", "skeletons": "none"}
        listing = Export([spec], "none", keywords)
    except (pskel.Error, ValueError) as error:
        raise DataError(f"expected a log, an export or recorded clips, found {spec!r} ({first_line(error)})") from error
    if listing.failures:
        name, error_text = listing.failures[0]
        raise DataError(f"the log cannot be opened: {error_text.splitlines()[0]}: {name}")
    names: dict[str, str] = {}
    for shard, text, _, _ in listing.shards:
        names.setdefault(text, shard.rpartition("-")[0])
    if not names:
        raise DataError(f"expected a log with frames, found none: {spec}")
    for text, name in names.items():
        yield _Listed(text, name)


def _in_rounds(processes: Processes, jobs: Sequence[Any], texts: Sequence[str], say: Say) -> None:
    """Do jobs in child processes, one at a time for each process of the training. Raises ``DataError`` if one fails."""
    # A process that is late must not see what another one has done in the meantime.
    jobs, texts = processes.share_object((list(jobs), list(texts)))
    for first in range(0, len(jobs), processes.count):
        failure = None
        mine = first + processes.rank
        if mine < len(jobs):
            function, arguments = jobs[mine]
            say(f"[{mine + 1}/{len(jobs)}] {texts[mine]}")
            try:
                _in_child(function, *arguments)
            except DataError as error:
                failure = str(error)
        with processes.agreed():
            if failure is not None:
                raise DataError(failure)


def _in_child(function: Callable[..., None], *arguments: Any) -> None:
    """Call a function in a process of its own, so that this one opens no device: workers are forked from it.

    Raises ``DataError`` if it fails, or if the process is killed.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_run, args=(sender, function, arguments), daemon=True)
    child.start()
    sender.close()
    try:
        failure = receiver.recv()
    except EOFError:
        child.join()
        raise DataError(
            f"a process that prepares data ended with exit code {child.exitcode} (-9: out of memory?)"
        ) from None
    finally:
        receiver.close()
    child.join()
    if failure is not None:
        raise DataError(failure)


def _run(sender: Connection, function: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    try:
        function(*arguments)
        sender.send(None)
    except KeyboardInterrupt:
        pass
    except TrainError as error:
        sender.send(str(error))
    except Exception as error:  # the parent says what happened
        sender.send(f"{type(error).__name__}: {first_line(error)}")


def _chosen(by_spec: Sequence[Sequence[Drive]], options: DataOptions, recipe: dict[str, Any], say: Say) -> Data:
    """Choose the clips for training and validation, and how often those of a log are drawn."""

    def track(drive: Drive, **choice: Any) -> Track:
        return Track.create(
            drive,
            frames=options.frames,
            every=options.every,
            hz=options.hz,
            stride=options.stride,
            cameras=options.cameras,
            **choice,
        )

    train: list[Track] = []
    validation: list[Track] = []
    spec_of: list[int] = []
    for number, drives in enumerate(by_spec):
        for drive in drives:
            is_held_out = any(fnmatchcase(drive.log, pattern) for pattern in options.hold_out_logs)
            if not is_held_out:
                train.append(track(drive, hold_out=options.hold_out))
                spec_of.append(number)
            if drive.variant == 0 and is_held_out:
                validation.append(track(drive))
            elif drive.variant == 0 and options.hold_out:
                validation.append(track(drive, hold_out=options.hold_out, held_out=True))
    for each in train:
        if not len(each):
            found = sum(len(run) for run in each.runs)
            say(f"{each.drive.source}: left out, {found} frames are too few for clips of {options.frames}")
    if not any(len(each) for each in train):
        least = (options.frames - 1) * max((each.step for each in train), default=1) + 1
        counts = [sum(len(run) for run in each.runs) for each in train]
        raise DataError(f"expected a log of at least {least} frames without a gap, found logs of {counts}")
    shares = _shares(train, spec_of, len(by_spec), options.weights)
    return Data(train, shares, [each for each in validation if len(each)], recipe)


def _shares(
    tracks: Sequence[Track], spec_of: Sequence[int], specs: int, weights: tuple[float, ...] | Mapping[str, float] | None
) -> list[float] | None:
    """Return the share of each track: the weight of its --data or its log, divided by clips."""
    if weights is None:
        return None
    if isinstance(weights, Mapping):
        groups: list[Any] = [track.drive.log for track in tracks]
        matching = [[w for pattern, w in weights.items() if fnmatchcase(log, pattern)] for log in groups]
        of_track = [found[0] if found else 1.0 for found in matching]
        if unused := [pattern for pattern in weights if not any(fnmatchcase(log, pattern) for log in groups)]:
            raise ConfigError(f"expected patterns of logs in data.weights, found {unused[0]!r}, which no log matches")
    else:
        if len(weights) != specs:
            raise ConfigError(f"expected data.weights of {specs} numbers, one for each --data, found {len(weights)}")
        groups, of_track = list(spec_of), [weights[spec] for spec in spec_of]
    totals: dict[Any, int] = {}
    for group, track in zip(groups, tracks):
        totals[group] = totals.get(group, 0) + len(track)
    return [weight * len(track) / max(1, totals[group]) for weight, group, track in zip(of_track, groups, tracks)]
