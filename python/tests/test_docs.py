"""The examples of docs/PYTHON.md are one program that runs."""

import importlib.util
import re
import textwrap
from pathlib import Path

from conftest import Run

PAGE = Path(__file__).parents[2] / "docs" / "PYTHON.md"


def test_the_examples_run_in_order(tmp_path: Path, run: Run) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    if importlib.util.find_spec("torch") is None:
        blocks = [block for block in blocks if "torch" not in block]
    assert len(blocks) >= 6
    program = tmp_path / "page.py"
    body = textwrap.indent("\n".join(blocks), "    ")
    program.write_text(f'import os\n\nif __name__ == "__main__":\n    os.chdir({str(tmp_path)!r})\n{body}')
    done = run(str(program), check=False)
    assert done.returncode == 0, done.stderr
    assert "(6, 56, 100, 3) float32" in done.stdout and "10.0\n" in done.stdout, done.stdout
