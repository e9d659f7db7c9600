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
    covariances = [np.atleast_2d(np.cov(features, rowvar=False)) for features in (first, second)]
    difference = first.mean(0) - second.mean(0)
    # The square roots of the eigenvalues of A B are the singular values of A^½ B^½.
    halves = [_root(covariance) for covariance in covariances]
    shared = np.linalg.svd(halves[0] @ halves[1], compute_uv=False).sum()
    return float(difference @ difference + sum(np.trace(covariance) for covariance in covariances) - 2 * shared)


def _root(covariance: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(covariance)
    root: np.ndarray = (vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T
    return root
