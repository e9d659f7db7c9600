"""The examples of docs/src/guide/python.md are one program that runs; classes document their parameters."""

import importlib.util
import inspect
import os
import re
import textwrap
from pathlib import Path

import pskel
import pytest
from conftest import Run

PAGE = Path(__file__).parents[2] / "docs/src/guide/python.md"


def page() -> list[str]:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 8
    return blocks


def test_the_examples_are_typed(tmp_path: Path, run: Run) -> None:
    for package in ("mypy", "torch", "gymnasium"):
        pytest.importorskip(package)
    program = tmp_path / "page.py"
    program.write_text("\n".join(page()))
    done = run("-m", "mypy", "--cache-dir", os.devnull, str(program), check=False)
    assert done.returncode == 0, done.stdout


def test_the_examples_run_in_order(tmp_path: Path, run: Run) -> None:
    blocks = page()
    missing = [package for package in ("torch", "gymnasium") if importlib.util.find_spec(package) is None]
    blocks = [block for block in blocks if not any(re.search(rf"(import|from) {package}", block) for package in missing)]
    program = tmp_path / "page.py"
    body = textwrap.indent("\n".join(blocks), "    ")
    program.write_text(f'import os\n\nif __name__ == "__main__":\n    os.chdir({str(tmp_path)!r})\n{body}')
    done = run(str(program), check=False)
    assert done.returncode == 0, done.stderr
    assert "(6, 56, 100, 3) float32" in done.stdout and "10.0\n" in done.stdout, done.stdout
    assert done.stdout.endswith("(6, 56, 100, 3)\n"), done.stdout


@pytest.mark.parametrize("kind", [pskel.Renderer, pskel.ResetAndRoll, pskel.Simulation, pskel.Scene])
def test_classes_document_their_options(kind: type) -> None:
    parameters = inspect.signature(kind).parameters.values()
    names = [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
    documented = re.findall(r"`(\w+)`|^ *(\w+) : ", kind.__doc__ or "", re.MULTILINE)
    missing = set(names) - {name for pair in documented for name in pair}
    assert names and not missing
