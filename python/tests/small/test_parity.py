"""The small network in PyTorch has the outputs that the program's kernels are compared with."""

import pytest

torch = pytest.importorskip("torch")
safetensors = pytest.importorskip("safetensors.torch")
import parity  # noqa: E402
from pskel.models.small.weights import load  # noqa: E402


@pytest.mark.parametrize(("weights", "name", "step"), [(parity.FOLDER / "small.safetensors", "small", 1), (parity.SHIPPED, "shipped", parity.STEP)])
def test_outputs_are_those_of_the_files(weights: object, name: str, step: int) -> None:
    expected = safetensors.load_file(parity.FOLDER / f"{name}-outputs.safetensors")
    found = parity.outputs(load(str(weights)), step)
    assert found.keys() == expected.keys()
    for key, values in expected.items():
        off = (found[key] - values).abs().max() / values.std()
        assert values.std() > 0.01 and off < 5e-5, (key, float(off))
