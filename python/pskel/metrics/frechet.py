"""Fréchet distance between two sets of features."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import numbers


def frechet_distance(a: ArrayLike, b: ArrayLike) -> float:
    """Return the squared Fréchet distance between normal distributions fitted to two sets of features.

    a, b: [N, D] and [M, D], N and M at least 2. Computed in float64 as |mean difference|² + tr(A) + tr(B) - 2 tr((A B)^½)
    with the sample covariances A and B, as in FID (Heusel et al., 2017).

    Raises ValueError if the shapes do not fit or if a value is not finite.
    """
    first, second = (numbers(features).astype(np.float64) for features in (a, b))
    for features in (first, second):
        if features.ndim != 2 or features.shape[0] < 2 or features.shape[1] != first.shape[1]:
            found = f"{list(first.shape)} and {list(second.shape)}"
            raise ValueError(f"expected features [N, D] and [M, D] with N and M of 2 or more, found {found}")
        if not np.isfinite(features).all():
            raise ValueError("expected finite features, found others")
    difference = first.mean(0) - second.mean(0)
    factors = [_factor(features) for features in (first, second)]
    # With A = XᵀX and B = YᵀY, the square roots of the eigenvalues of A B are the singular values of X Yᵀ.
    shared = np.linalg.svd(factors[0] @ factors[1].T, compute_uv=False).sum()
    traces = sum((factor**2).sum() for factor in factors)
    return float(difference @ difference + traces - 2 * shared)


def _factor(features: np.ndarray) -> np.ndarray:
    """Return X with the sample covariance XᵀX, with at most as many rows as columns."""
    deviations: np.ndarray = (features - features.mean(0)) / np.sqrt(len(features) - 1)
    if len(deviations) <= deviations.shape[1]:
        return deviations
    return np.asarray(np.linalg.qr(deviations, mode="r"))
