"""Writes a long log in the layout of py123d, which repeats the rows of a recorded one: for measuring how logs open.

Run: python3 tests/peers/long_123d.py FOLDER OUT [FRAMES]   (pyarrow; 10,000 frames by default)

FOLDER has one log with tables of one row per frame, such as PandaSet's. Images are cut off after 20 kB: 2.5 GB in all.
Then: /usr/bin/time -v pskel render 123d:OUT --skeleton none --out none, which ends after the log is open.
"""

import pathlib
import sys

import numpy as np
import pyarrow as pa

PERIOD_US = 100_000
IMAGE_BYTES = 20_000


def column(field: pa.Field, table: pa.Table, rows: np.ndarray, is_sync: bool) -> pa.Array:
    """Returns the values of a column in the given rows of the long table."""
    name = field.name.rsplit(".", 1)[-1]
    if is_sync and not field.name.startswith("sync."):
        return pa.array(rows)
    if name.endswith("timestamp_us"):
        return pa.array(table[field.name][0].as_py() + PERIOD_US * rows)
    values = table[field.name].combine_chunks().take(pa.array(rows % table.num_rows))
    if name == "data" and field.name.startswith("camera."):
        values = pa.array([value[:IMAGE_BYTES] for value in values.to_pylist()], field.type)
    return values


def main() -> None:
    source, out = map(pathlib.Path, sys.argv[1:3])
    frames = int(sys.argv[3]) if len(sys.argv) > 3 else 10_000
    log = next(source.glob("logs/*/*"))
    folder = out / log.relative_to(source)
    folder.mkdir(parents=True)
    for path in sorted(log.glob("*.arrow")):
        if path.stem in ("map", "route_position"):
            continue
        table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
        step = 10 if path.stem.startswith("camera.") else 1000
        with pa.OSFile(str(folder / path.name), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
            for start in range(0, frames, step):
                rows = np.arange(start, min(frames, start + step), dtype=np.int64)
                arrays = [column(field, table, rows, path.stem == "sync").cast(field.type) for field in table.schema]
                writer.write_batch(pa.record_batch(arrays, schema=table.schema))


main()
