"""Arguments that are arrays, by the rules of the extension module."""

from typing import Any

import numpy as np
import numpy.typing as npt


def numbers(value: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return the array of an argument.

    Raises ``TypeError`` for masked values, which ``numpy.asarray`` would uncover, and for other than real numbers.
    """
    parts = value if isinstance(value, (list, tuple)) else [value]
    if any(isinstance(part, np.ma.MaskedArray) and np.any(part.mask) for part in parts):
        raise TypeError("expected an array without masked values, found masked ones: drop or fill them")
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"expected an array of real numbers, found dtype {array.dtype}")
    return array
