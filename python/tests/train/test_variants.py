"""Named trainings: settings of each network, and the names and conditions of the program's ablation."""

import json
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("accelerate")
pytest.importorskip("diffusers")
from pskel.models.pas_image import task as image  # noqa: E402
from pskel.models.pas_image.step import StepOptions  # noqa: E402
from pskel.models.small import task as small  # noqa: E402
from pskel.train import Config, ConfigError  # noqa: E402
from pskel.train.variants import VARIANTS  # noqa: E402

PAIRS = [(name, network) for name, variant in VARIANTS.items() for network in variant.settings]


def configuration(folder: Path, network: str, *settings: str, variant: str | None = None) -> Config:
    """A file that drops nothing, with a variant."""
    drops = {"drop_color": 0.0, "drop_depth": 0.0}
    (folder / "config.json").write_text(json.dumps({"network": network, "data": {"frames": 2}, network: drops}))
    return Config.read(folder / "config.json", settings, variant)


@pytest.mark.parametrize(("name", "network"), PAIRS)
def test_variants_never_have_their_dropped_conditions(name: str, network: str, tmp_path: Path) -> None:
    config = configuration(tmp_path, network, variant=name)
    dropped = {condition for condition in ("color", "depth") if config.options[f"drop_{condition}"] == 1.0}
    without = {"layout": "color depth", "previous_clean": "color depth", "previous_noised": "color depth", "color": "depth"}
    assert dropped == set(VARIANTS[name].dropped) == set(without.get(name, "").split())
    assert config.data.augment == (name in ("augmentation", "relative_depth", "metric_depth"))
    assert not config.data.augment or config.data.variants == 5
    if network == "small":
        recipe = small.task(config.options, config.train).network.config.recipe
        scale = recipe.get("bins", {}).get("scale")
    else:
        steps = {field.name for field in fields(StepOptions)}
        assert set(config.options) <= steps | {field.name for field in fields(image.TaskOptions)}
        options = StepOptions(**{key: value for key, value in config.options.items() if key in steps})
        levels = options.previous_from, options.previous_to
        assert options.previous_share == (0.0 if name == "layout" else 0.5)
        assert options.single_frames == (1.0 if name == "layout" else 0.1)
        assert name == "layout" or levels == ((0, 0) if name == "previous_clean" else (50, 200))
        scale = image.recipe(config.options)["bins"].get("scale")
    assert scale == "log" if name == "relative_depth" else scale in (None, "linear")


def test_settings_come_after_the_variant(tmp_path: Path) -> None:
    config = configuration(tmp_path, "small", "small.drop_color=0.25", "data.augment=true", variant="color")
    assert config.options == {"drop_color": 0.25, "drop_depth": 1.0, "errors": 0.8}
    assert config.data.augment


def test_unknown_variants_are_named(tmp_path: Path) -> None:
    def message(*arguments: Any, **others: Any) -> str:
        with pytest.raises(ConfigError) as error:
            configuration(tmp_path, *arguments, **others)
        return str(error.value)

    known = ", ".join(name for name in VARIANTS if name != "layout")
    expected = f"expected --variant of {known} for network small, found 'layout'"
    assert message("small", variant="layout") == f"{expected}: {tmp_path / 'config.json'}"
    assert message("pas", variant="color").startswith("expected network small or pas-image with --variant, found pas")
    with pytest.raises(ValueError, match="expected bin_scale of linear, log, found 'x'"):
        image.recipe({"bin_scale": "x"})


def test_names_are_those_of_the_protocol() -> None:
    command = [sys.executable, "-m", "pskel", "protocol", "ablation", "town:seed=1", "--skeletons", "x", "--out", "x"]
    done = subprocess.run([*command, "--variant", "other=x"], capture_output=True, text=True, check=False)
    listed = re.search(r"expected the variant of the training (.*), found \"other\"", done.stderr)
    assert listed, done.stderr
    assert listed[1].replace(" or ", ", ").split(", ") == list(VARIANTS)
