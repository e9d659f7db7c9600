"""The table of docs/src/reference/pas.md is what the command prints."""

import json
import os
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("diffusers")
from pskel.models.pas.cost import cost, main  # noqa: E402
from pskel.models._rig import PUBLISHED  # noqa: E402

PAGE = Path(__file__).parents[3] / "docs/src/reference/pas.md"
SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
CHECKPOINT = Path(os.environ.get("PSKEL_FIXTURES", SHARED / "fixtures")) / "pas-network" / "nuscenes.json"


def test_the_page_has_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    table = capsys.readouterr().out
    assert len(table.splitlines()) == 9 and table in PAGE.read_text()


@pytest.mark.skipif(not CHECKPOINT.exists(), reason="pas-network is not there (set PSKEL_SHARED)")
def test_parameters_are_those_of_the_checkpoint() -> None:
    for known in PUBLISHED:
        found = cost(known)
        assert found.parameters == json.loads(CHECKPOINT.read_text())["parameters"]
        # Each token takes at least two operations a weight of the joint blocks, and each window some per token alone.
        tokens = known.frames * len(known.cameras) * known.size[0] * known.size[1] // 16**2
        assert 2 * tokens * 1.0e9 < found.call_operations < 2 * tokens * 8.0e9


def test_a_wrong_configuration_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "c.json"
    path.write_text('{"num_layers": "many"}')
    assert main(["--config", str(path)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "expected num_layers of type int" in error and error.strip().endswith("c.json")
