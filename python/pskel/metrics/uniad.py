"""Figures of UniAD on generated images: `python -m pskel.metrics.uniad RESULTS` (docs/src/guide/perception.md)."""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .._whole import write_whole

_PROGRAM = "pskel.metrics.uniad"
_RESULTS = "results_nusc.json"
_MAPS = ("lanes", "drivable", "divider", "crossing")
_SECONDS = (1, 2, 3)

#: Figures by the task that they belong to, with their units. Percentages are those of UniAD times 100.
TASKS: dict[str, tuple[str, ...]] = {
    "detection": ("mAP (%)", "NDS (%)"),
    "mapping": ("Lanes (%)", "Drivable (%)", "Divider (%)", "Crossing (%)"),
    "planning": (
        *(f"L2 {second} s (m)" for second in _SECONDS),
        "L2 avg. (m)",
        *(f"Col. {second} s (%)" for second in _SECONDS),
        "Col. avg. (%)",
    ),
    "tracking": ("AMOTA", "AMOTP (m)"),
    "motion": ("minADE (m)", "minFDE (m)", "MR"),
    "occupancy": ("IoU-n. (%)", "IoU-f. (%)", "VPQ-n. (%)", "VPQ-f. (%)"),
}

#: Columns of papers on generated images, such as DriveArena.
COLUMNS = (*TASKS["detection"], *TASKS["mapping"], *TASKS["planning"][:3])


@dataclass
class Figures:
    """Figures of a run of UniAD by their names in `TASKS`, and why those of other tasks are missing."""

    values: dict[str, float] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)
    planning_definition: str | None = None
    """Whether planning figures are those at a time (`uniad`), or means up to it (`stp3`)."""
    samples: int | None = None
    """Number of samples in the results."""


def read_figures(results: Path, log: Path | None = None, generated: Path | None = None) -> Figures:
    """Read what UniAD wrote: a result folder, or its results_nusc.json; for planning, motion and occupancy its output.

    `generated` is the list generated.json of a copy, whose samples must be those of the results. Raises ValueError if
    they are others, or if a file has another content.
    """
    folder = results if results.is_dir() else results.parent
    file = results / _RESULTS if results.is_dir() else results
    figures = Figures()
    if not results.is_dir() or file.exists():
        _read_results(file, generated, figures)
    elif generated is not None:
        raise ValueError(f"expected {_RESULTS} to compare with {generated}, found none: {folder}")
    else:
        figures.missing["mapping"] = f"{_RESULTS} is missing"
    _read_summary(
        folder / "det/metrics_summary.json",
        "detection",
        {"mAP (%)": ("mean_ap", 100), "NDS (%)": ("nd_score", 100)},
        figures,
    )
    _read_summary(
        folder / "track/metrics_summary.json", "tracking", {"AMOTA": ("amota", 1), "AMOTP (m)": ("amotp", 1)}, figures
    )
    _read_log(log, figures)
    return figures


def _read_results(path: Path, generated: Path | None, figures: Figures) -> None:
    """Read the samples and the areas of maps: IoU is the sum of intersections over the sum of unions, as UniAD's."""
    content = _json(path)
    results = content.get("results") if isinstance(content, dict) else None
    if not isinstance(results, dict):
        raise ValueError(f"expected results of UniAD with boxes by sample (results), found another file: {path}")
    figures.samples = len(results)
    if generated is not None:
        _check_samples(results.keys(), path, generated)
    areas = content.get("map_results") or {}
    if not areas:
        figures.missing["mapping"] = f"no map_results in {path.name}"
        return
    for name, title in zip(_MAPS, TASKS["mapping"], strict=True):
        try:
            shared, both = (
                math.fsum(float(area[f"{name}_{kind}"]) for area in areas.values())
                for kind in ("intersection", "union")
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ValueError(
                f"expected {name}_intersection and {name}_union of each sample, found others: {path}"
            ) from error
        figures.values[title] = 100 * shared / both if both else math.nan


def _check_samples(found: Iterable[str], path: Path, generated: Path) -> None:
    content = _json(generated)
    try:
        expected = {sample["token"] for sample in content["samples"]}
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"expected the list of generated samples of a copy, found another file: {generated}"
        ) from error
    others, missing = sorted(set(found) - expected), sorted(expected - set(found))
    if others or missing:
        first = f"{others[0]!r} is another" if others else f"{missing[0]!r} is missing"
        raise ValueError(
            f"expected results of the {len(expected)} samples in {generated}, "
            f"found {len(missing)} missing and {len(others)} others ({first}): {path}"
        )


def _read_summary(path: Path, task: str, fields: dict[str, tuple[str, float]], figures: Figures) -> None:
    """Read some numbers of a file metrics_summary.json, with their factors."""
    if not path.exists():
        figures.missing[task] = f"{path.parent.name}/{path.name} is missing"
        return
    content = _json(path)
    for title, (name, factor) in fields.items():
        value = content.get(name) if isinstance(content, dict) else None
        if not isinstance(value, (int, float)):
            raise ValueError(f"expected a number {name}, found {value!r}: {path}")
        figures.values[title] = factor * value


def _read_log(path: Path | None, figures: Figures) -> None:
    """Read tables of UniAD's printed output; of several runs, the last one."""
    tasks = ("planning", "motion", "occupancy")
    if path is None:
        figures.missing.update(dict.fromkeys(tasks, "UniAD prints it only: pass its output with --log"))
        return
    text = path.read_text(errors="replace")
    for task, read in zip(tasks, (_read_planning, _read_motion, _read_occupancy), strict=True):
        if not read(text, figures):
            figures.missing[task] = f"no such table in {path}"


def _read_planning(text: str, figures: Figures) -> bool:
    """Read the errors at 1, 2 and 3 s, of a table with columns from 0.5 to 3 s; the boxes' collisions, as papers do."""
    titles = list(re.finditer(r"(\w+)'s definition planning metrics", text))
    rows = _rows(text[titles[-1].end() :]) if titles else {}
    if len(rows.get("L2", [])) != 6 or len(rows.get("obj_box_col", [])) != 6:
        return False
    figures.planning_definition = titles[-1][1]
    for title, unit, name, factor in (("L2", "m", "L2", 1.0), ("Col.", "%", "obj_box_col", 100.0)):
        values = [factor * rows[name][2 * second - 1] for second in _SECONDS]
        for second, value in zip(_SECONDS, values, strict=True):
            figures.values[f"{title} {second} s ({unit})"] = value
        figures.values[f"{title} avg. ({unit})"] = sum(values) / len(values)
    return True


def _read_motion(text: str, figures: Figures) -> bool:
    """Read the standard errors of the class car, into which the motion categories merge vehicles."""
    of_motion = text.rpartition("Evaluate on motion category")[2]
    header = re.search(r"\|\s*class names\s*\|(.*)\|", of_motion)
    if header is None:
        return False
    names = [name.strip() for name in header[1].split("|")]
    row = dict(zip(names, _rows(of_motion[header.end() :]).get("car", []), strict=False))
    titles = dict(zip(("min_ade_err", "min_fde_err", "miss_rate_err"), TASKS["motion"], strict=True))
    if not titles.keys() <= row.keys():
        return False
    figures.values.update({title: row[name] for name, title in titles.items()})
    return True


def _read_occupancy(text: str, figures: Figures) -> bool:
    """Read IoU and panoptic quality, near (30 m) and far (100 m), which are percentages already."""
    printed = text.rpartition("Occ-flow Val Results:")[2]
    for name, titles in (("iou", TASKS["occupancy"][:2]), ("pq", TASKS["occupancy"][2:])):
        found = re.search(rf"^{name}\s*\n\s*([\d.]+|nan) & ([\d.]+|nan)\s*$", printed, re.MULTILINE)
        if found is None:
            return name == "pq"  # not evaluated by all configurations
        figures.values.update({title: float(value) for title, value in zip(titles, found.groups(), strict=True)})
    return True


def _rows(text: str) -> dict[str, list[float]]:
    """Return the numbers of a printed table's first rows by their name; another row of a name is of another table."""
    rows: dict[str, list[float]] = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.strip().startswith("|") and all(re.fullmatch(r"-?\d+(\.\d+)?|nan", cell) for cell in cells[1:]):
            rows.setdefault(cells[0], [float(cell) for cell in cells[1:]])
    return rows


def _json(path: Path) -> Any:
    try:
        with open(path, "rb") as file:
            return json.load(file)
    except ValueError as error:
        raise ValueError(f"expected JSON, found another file ({error}): {path}") from error


def table(figures: Figures, columns: Sequence[str]) -> str:
    """Return a Markdown table of one row; figures that are missing or undefined are `-`."""

    def cell(column: str) -> str:
        value = figures.values.get(column, math.nan)
        return (
            "-"
            if math.isnan(value)
            else f"{value:.3f}"
            if column in {"AMOTA", "AMOTP (m)", *TASKS["motion"]}
            else f"{value:.2f}"
        )

    rows = (columns, ["---:"] * len(columns), [cell(column) for column in columns])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status, after an error in one line on standard error."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {_PROGRAM}", description="Print the figures of UniAD from its result files."
    )
    parser.add_argument(
        "results", type=Path, metavar="RESULTS", help=f"UniAD's result folder (test/CONFIG/TIME), or its {_RESULTS}"
    )
    parser.add_argument(
        "--log",
        type=Path,
        metavar="FILE",
        help="its printed output (work_dirs/../logs/eval.*): planning, motion, occupancy",
    )
    parser.add_argument(
        "--generated",
        type=Path,
        metavar="FILE",
        help="generated.json of the copy: fail if the results have other samples",
    )
    parser.add_argument(
        "--all", action="store_true", help="all figures, in place of the nine columns of papers on generated images"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="also write all figures as JSON")
    options = parser.parse_args(arguments)
    try:
        figures = read_figures(options.results, options.log, options.generated)
        if not figures.values:
            reasons = "; ".join(f"no {task}: {why}" for task, why in figures.missing.items())
            raise ValueError(f"expected results of UniAD, found none ({reasons}): {options.results}")
        columns = [column for columns in TASKS.values() for column in columns] if options.all else COLUMNS
        print(table(figures, columns))
        for task, why in figures.missing.items():
            if options.all or set(TASKS[task]) & set(columns):
                print(f"no {task}: {why}", file=sys.stderr)
        if figures.planning_definition == "stp3":
            print("planning: means up to the time (stp3's definition), not the values at it", file=sys.stderr)
        if options.out is not None:
            write_whole(options.out, _content(figures))
    except (ValueError, OSError) as error:
        print(f"{_PROGRAM}: {error}", file=sys.stderr)
        return 1
    return 0


def _content(figures: Figures) -> bytes:
    values = {name: None if math.isnan(value) else value for name, value in figures.values.items()}
    content = {
        "samples": figures.samples,
        "planning_definition": figures.planning_definition,
        "figures": values,
        "missing": figures.missing,
    }
    return (json.dumps(content, indent=2) + "\n").encode()


if __name__ == "__main__":
    sys.exit(main())
