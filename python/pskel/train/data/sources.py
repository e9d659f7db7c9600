"""Everything that ``--data`` names, as clips for training and for validation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

from ..config import DataOptions
from ..errors import ConfigError, DataError, first_line
from ..parallel import Processes
from .captions import content_of, read_captions
from .exports import export_options
from .jobs import Say, in_rounds
from .logs import is_town, open_log
from .pas_cache import PasCacheReader, recipe_of_cache
from .reader import ClipSet, FrameReader
from .recipe import complete, difference
from .recorded import RecordedReader, recordings_in
from .rendered import RenderedReader, RenderedSource, Variant, build_skeleton, record
from .shards import shard_readers

__all__ = ["Data", "open_data"]


class Data(NamedTuple):
    """Clips of a training."""

    train: list[ClipSet]
    shares: list[float] | None
    validation: list[ClipSet]
    recipe: dict[str, Any]

    def to_json(self) -> list[Any]:
        """Return what a training depends on: logs, variants, and numbers of clips."""
        return [[clip_set.reader.log, clip_set.reader.variant, len(clip_set)] for clip_set in self.train]


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
        stored = [_stored(spec) for spec in specs]
    by_spec: list[Sequence[FrameReader]] = []
    for spec, readers in zip(specs, stored):
        if readers is None:
            with processes.agreed():
                wanted = wanted or _recipe_of_logs(spec, options)
            readers = _logs(spec, options, wanted, processes, say)
        by_spec.append(readers)
        with processes.agreed():
            wanted = _same_recipe(readers, wanted, say)
    assert wanted is not None
    with processes.agreed():
        return _chosen(by_spec, options, wanted, say)


def _same_recipe(readers: Sequence[FrameReader], wanted: dict[str, Any] | None, say: Say) -> dict[str, Any]:
    """Check that readers are of a recipe, by default the first reader's; returns it."""
    for reader in readers:
        found = reader.recipe
        wanted = wanted or complete({key: value for key, value in found.items() if value is not None})
        if (text := difference(wanted, found)) is not None:
            raise DataError(f"{text}: {reader.source}")
        if found["drawn"] is None:
            say(f"{reader.source}: rendered at the cameras' own sizes, which are not compared with the recipe")
        reader.recipe = wanted
    assert wanted is not None
    return wanted


def _stored(spec: str) -> Sequence[FrameReader] | None:
    """Open recordings or shards; ``None`` if the text is a log."""
    path = Path(spec)
    if path.suffix == ".safetensors":
        return [RecordedReader(path)]
    if path.is_dir() and (path / "export.json").is_file():
        layout = export_options(path)["export_layout"]
        if layout == "webdataset":
            return shard_readers(path)
        if layout == "pas-cache":
            raise ConfigError(
                f"a pas-cache has maps alone: name it by data.pas_cache, and the logs by --data, found {spec}"
            )
        raise DataError(f"expected an export in the layout webdataset, found {layout}: {spec}")
    if path.is_dir() and (recordings := recordings_in(path)):
        return [RecordedReader(each) for each in recordings]
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
    spec: str, options: DataOptions, recipe: dict[str, Any], processes: Processes, say: Say
) -> Sequence[FrameReader]:
    """Open logs, and say which ones have no captions if there is a file of them."""
    readers = _opened(spec, options, recipe, processes, say)
    without = [each.log for each in readers if each.variant == 0 and each.captions is None]
    if options.captions is not None and without:
        say(f"{options.captions}: no captions of {len(without)} logs, such as {without[0]}; theirs are empty")
    return readers


def _opened(
    spec: str, options: DataOptions, recipe: dict[str, Any], processes: Processes, say: Say
) -> Sequence[FrameReader]:
    """Open logs. Skeletons are built and clips are recorded in rounds: each process does one, then all go on."""
    with processes.agreed():
        listed = list(_listed(spec))
        if options.captions is not None:
            read_captions(options.captions)  # before anything that takes long
        if options.pas_cache is not None:
            folder = Path(options.pas_cache)
            if (text := difference(recipe, recipe_of_cache(folder))) is not None:
                raise DataError(f"{text}: {folder}")
            return [PasCacheReader(log.text, folder, recipe, options.captions) for log in listed]
        skeletons = options.skeletons or (None if options.cache is None else f"{options.cache}/skeletons")
        if skeletons is None:
            raise ConfigError(f"expected data.skeletons or data.cache, folders for rendering logs, found none: {spec}")
    folder = Path(skeletons)
    builds = [log for log in listed if not (folder / log.name / "skeleton.json").is_file()]
    texts = [f"building the skeleton of {log.name}" for log in builds]
    in_rounds(processes, [(build_skeleton, (log.text, str(folder / log.name))) for log in builds], texts, say)
    sources = [
        RenderedSource(
            log.text,
            folder / log.name,
            recipe,
            Variant.create(log.name, number, town=is_town(log.text), augment=options.augment),
            options.captions,
            options.rasterizer,
        )
        for log in listed
        for number in range(options.variants)
    ]
    if options.cache is not None:
        return _recorded([log.name for log in listed], sources, Path(options.cache), processes, say)
    with processes.agreed():
        return [RenderedReader(source) for source in sources]


def _recorded(
    names: Sequence[str], sources: Sequence[RenderedSource], cache: Path, processes: Processes, say: Say
) -> list[FrameReader]:
    """Return the recordings of rendered logs, which are made if they do not exist."""
    of_sources = [names[number * len(names) // len(sources)] for number in range(len(sources))]
    paths = [cache / f"{name}-{source.change.label}.safetensors" for name, source in zip(of_sources, sources)]
    missing = [(source, path) for source, path in zip(sources, paths) if not path.is_file()]
    texts = [f"recording {path.name}" for _, path in missing]
    in_rounds(processes, [(record, (source, path)) for source, path in missing], texts, say)
    found: list[FrameReader] = []
    with processes.agreed():
        for source, path in zip(sources, paths):
            recording = RecordedReader(path)
            if recording.identity != source.identity():
                what = "a recording of this skeleton and recipe"
                raise DataError(f"expected {what}, found another one; remove it, or choose another data.cache: {path}")
            if recording.captions_content != content_of(source.captions):
                captions = source.captions
                recording.captions = None if captions is None else read_captions(captions).of(open_log(source.text))
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


def _chosen(by_spec: Sequence[Sequence[FrameReader]], options: DataOptions, recipe: dict[str, Any], say: Say) -> Data:
    """Choose the clips for training and validation, and how often a log's clips are drawn."""

    def clip_set(reader: FrameReader, **choice: Any) -> ClipSet:
        return ClipSet.create(
            reader,
            frames=options.frames,
            every=options.every,
            hz=options.hz,
            stride=options.stride,
            cameras=options.cameras,
            **choice,
        )

    train: list[ClipSet] = []
    validation: list[ClipSet] = []
    spec_of: list[int] = []
    for number, readers in enumerate(by_spec):
        for reader in readers:
            is_held_out = any(fnmatchcase(reader.log, pattern) for pattern in options.hold_out_logs)
            if not is_held_out:
                train.append(clip_set(reader, hold_out=options.hold_out))
                spec_of.append(number)
            if reader.variant == 0 and is_held_out:
                validation.append(clip_set(reader))
            elif reader.variant == 0 and options.hold_out:
                validation.append(clip_set(reader, hold_out=options.hold_out, held_out=True))
    for each in train:
        if not len(each):
            found = sum(len(run) for run in each.runs)
            say(f"{each.reader.source}: left out, {found} frames are too few for clips of {options.frames}")
    if not any(len(each) for each in train):
        least = (options.frames - 1) * max((each.step for each in train), default=1) + 1
        counts = [sum(len(run) for run in each.runs) for each in train]
        raise DataError(f"expected a log of at least {least} frames without a gap, found logs of {counts}")
    shares = _shares(train, spec_of, len(by_spec), options.weights)
    return Data(train, shares, [each for each in validation if len(each)], recipe)


def _shares(
    clip_sets: Sequence[ClipSet],
    spec_of: Sequence[int],
    specs: int,
    weights: tuple[float, ...] | Mapping[str, float] | None,
) -> list[float] | None:
    """Return the share of each clip set: the weight of its --data or its log, divided by clips."""
    if weights is None:
        return None
    if isinstance(weights, Mapping):
        groups: list[Any] = [clip_set.reader.log for clip_set in clip_sets]
        matching = [[w for pattern, w in weights.items() if fnmatchcase(log, pattern)] for log in groups]
        of_clip_set = [found[0] if found else 1.0 for found in matching]
        if unused := [pattern for pattern in weights if not any(fnmatchcase(log, pattern) for log in groups)]:
            raise ConfigError(f"expected patterns of logs in data.weights, found {unused[0]!r}, which no log matches")
    else:
        if len(weights) != specs:
            raise ConfigError(f"expected data.weights of {specs} numbers, one for each --data, found {len(weights)}")
        groups, of_clip_set = list(spec_of), [weights[spec] for spec in spec_of]
    totals: dict[Any, int] = {}
    for group, clip_set in zip(groups, clip_sets):
        totals[group] = totals.get(group, 0) + len(clip_set)
    of_group = zip(of_clip_set, groups, clip_sets)
    return [weight * len(clip_set) / max(1, totals[group]) for weight, group, clip_set in of_group]
