"""Golden maps: equal on every rasterizer; a change of a map, a frame or a camera is named."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pskel
import pytest
from conftest import TOWN, Run
from pskel import golden

OPTIONS = ("--frames", "1..3", "--out-size", "28x50")


@pytest.fixture(scope="module")
def made(log: pskel.Log, skeleton: pskel.Skeleton, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("golden") / "golden.json"
    assert golden.make(log, path, frames=(1, 3), out_size=(28, 50), skeleton=skeleton) == 2 * 6 * 4
    return path


def changed(made: Path, path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    content = json.loads(made.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return path


def test_rasterizers_and_machines_agree(log: pskel.Log, skeleton: pskel.Skeleton, made: Path) -> None:
    differences, rates = golden.check(log, made, rasterizers=["cpu", "compute"], skeleton=skeleton)
    assert differences == {"cpu": [], "compute": []}
    assert [rate.rasterizer for rate in rates] == ["cpu", "compute"] and all(rate.frames_per_s > 0 for rate in rates)
    # Anyone who renders the maps gets these hashes.
    with pskel.Renderer(skeleton, out_size=(28, 50), maps=["depth"]) as renderer:
        depth = renderer.render(log[2])["depth"]
    front = log[2].cameras.index("CAM_FRONT")
    expected = hashlib.sha256(depth[front].tobytes()).hexdigest()[:32]
    assert json.loads(made.read_text())["hashes"]["000002"]["CAM_FRONT"]["depth"] == expected


def test_differences_are_named(log: pskel.Log, skeleton: pskel.Skeleton, made: Path, tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        content["hashes"]["000001"]["CAM_BACK"]["class"] = "0" * 32
        del content["hashes"]["000002"]["CAM_FRONT"]["depth"]
        content["hashes"]["000002"]["CAM_NONE"] = {"color": "1"}

    differences, _ = golden.check(log, changed(made, tmp_path / "g.json", change), skeleton=skeleton)
    assert differences == {"cpu": ["000001/CAM_BACK/class", "000002/CAM_FRONT/depth", "000002/CAM_NONE/color"]}


def test_the_command_makes_and_checks(skeleton: pskel.Skeleton, made: Path, run: Run, tmp_path: Path) -> None:
    """``make`` builds a skeleton of its own: it is the same one."""
    done = run("-m", "pskel.golden", "make", TOWN, "g.json", *OPTIONS)
    assert done.stdout == "g.json: 48 maps\n" and (tmp_path / "g.json").read_bytes() == made.read_bytes()
    files = ("--skeleton", str(skeleton.path), "--rates", "rates.json", "--summary", "summary.md")
    check = ("-m", "pskel.golden", "check", TOWN, "g.json", *files)
    first = run(*check).stdout.splitlines()[-1].split(" | ")
    assert first[0] == "| cpu" and first[2] == "equal" and first[-1] == "- |"
    changed(made, tmp_path / "g.json", lambda content: content["hashes"]["000001"]["CAM_BACK"].update({"class": "2"}))
    done = run(*check, check=False)
    assert done.returncode == 1 and done.stderr == "cpu: 000001/CAM_BACK/class differs from g.json\n"
    second = done.stdout.splitlines()[-1].split(" | ")
    assert second[2] == "1 differ" and abs(float(second[-1].strip(" |")) - float(second[3]) / float(first[3])) < 0.02
    assert (tmp_path / "summary.md").read_text().count("| cpu |") == 2


def test_other_files_and_frames_are_refused(log: pskel.Log, made: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "text.json").write_text("none")
    (tmp_path / "other.json").write_text("[]")
    changed(made, tmp_path / "long.json", lambda content: content.update({"frames": [1, 9]}))
    for name, said in (
        ("text.json", "text.json: expected golden maps of pskel.golden make, found no JSON"),
        ("other.json", "other.json: expected golden maps of pskel.golden make, frames, hashes, maps, out_size; found another file"),
        ("long.json", "long.json: expected a log with 9 frames or more, found 4"),
        ("missing.json", "No such file or directory: 'missing.json'"),
    ):
        done = run("-m", "pskel.golden", "check", TOWN, name, check=False)
        assert done.returncode == 1 and said in done.stderr and "Traceback" not in done.stderr, done.stderr
    (tmp_path / "rates.json").write_text("[]")
    done = run("-m", "pskel.golden", "check", TOWN, str(made), "--rates", "rates.json", check=False)
    assert done.returncode == 1 and "rates.json: expected frames per second by rasterizer" in done.stderr, done.stderr
    with pytest.raises(ValueError, match=r"expected frames A\.\.B in 0\.\.4, found 2\.\.5"):
        golden.make(log, tmp_path / "none.json", frames=(2, 5))
    assert not (tmp_path / "none.json").exists()
