"""Matrices of distances as the neighbours write them: sparse, with infinite entries, one triangle alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._validate import as_reals


def filled(matrix: Any, name: str) -> tuple[NDArray[np.float64], float]:
    """A whole matrix of distances, and the longest edge; edges that are not there (infinite, not stored) are longer.

    As in Ripser, the upper triangle counts where there is one.
    """
    from scipy.sparse import csr_array, issparse  # SciPy takes a while to import

    if issparse(matrix):
        entries: Any = csr_array(matrix).tocoo()
        (row, column), value = entries.coords, as_reals(entries.data, name)
        dense, upper = np.full(entries.shape, np.inf), row < column
        np.fill_diagonal(dense, matrix.diagonal())
        for part in (~upper & (row != column), upper):
            dense[row[part], column[part]] = dense[column[part], row[part]] = value[part]
    else:
        dense = np.array(as_reals(matrix, name), np.float64)
        mirrored = np.triu(dense) + np.triu(dense, 1).T if dense.ndim == 2 and len(dense) == dense.shape[1] else dense
        dense = mirrored if np.allclose(dense, mirrored, rtol=1e-6, atol=0) else dense  # by rounding, not by mistake
    there = np.isfinite(dense)
    longest = float(dense.max(initial=0.0, where=there))
    dense[np.isposinf(dense)] = 2 * longest or 1.0
    return dense, np.inf if there.all() else longest
