"""Writes a whole checkpoint from the trained tensors: `python -m pskel.models.pas.training.merge`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from safetensors.torch import save_file

from ..._files import first_line
from ..checkpoint import as_header, read_header, read_tensors
from ..config import Config
from .modes import full_weights

__all__ = ["main", "merge"]

_PROGRAM = "pskel.models.pas.training.merge"


def merge(weights: str | os.PathLike[str], trained: str | os.PathLike[str], out: str | os.PathLike[str]) -> int:
    """Put the tensors of a training with ``export = "trained"`` into the checkpoint that it started from.

    Writes a safetensors file; returns the number of its tensors. Raises ``ValueError``, which names the file, for
    files that do not fit, and ``OSError``.
    """
    header = read_header(trained)
    if header.get("export") != "trained":
        found = header.get("export", "no such header")
        raise ValueError(f'expected weights of a training with export "trained", found {found}: {os.fspath(trained)}')
    config = Config.parse(header["config"], os.fspath(trained))
    try:
        tensors = full_weights(read_tensors(weights), read_tensors(trained), config, int(header["lora_rank"]))
    except ValueError as error:
        raise ValueError(f"{error}: {os.fspath(trained)}") from None
    partial = Path(out).with_name(f".{Path(out).name}.partial")
    stored = {name: tensor.contiguous() for name, tensor in tensors.items()}
    save_file(stored, partial, as_header({**header, "export": "full"}))
    partial.replace(out)
    return len(tensors)


def main(arguments: Sequence[str] | None = None) -> int:
    """Merge files; returns the exit status, after an error in one line on standard error."""
    parser = argparse.ArgumentParser(prog=f"python -m {_PROGRAM}", description=__doc__.split(":")[0] + ".")
    parser.add_argument("--weights", required=True, metavar="FILE", help="checkpoint that the training started from")
    parser.add_argument("--trained", required=True, metavar="FILE", help='weights of a training with export "trained"')
    parser.add_argument("--out", required=True, metavar="FILE", help="checkpoint to write, a safetensors file")
    options = parser.parse_args(arguments)
    try:
        if Path(options.out).suffix != ".safetensors":
            raise ValueError(f"expected --out with the suffix .safetensors, found {options.out}")
        count = merge(options.weights, options.trained, options.out)
    except (ValueError, OSError) as error:
        print(f"{_PROGRAM}: {first_line(error)}", file=sys.stderr)
        return 1
    print(f"merged {count} tensors: {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
