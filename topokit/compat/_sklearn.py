"""Loops as features of clouds, in a pipeline of scikit-learn.

Source: Buitinck et al. 2013, *API design for machine learning software*.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import validate_data

from topokit._validate import as_sequence, whole
from topokit.rips import rips_persistence_many


class LoopFeatures(TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """The longest-lived loops of clouds as numbers: a transformer of scikit-learn.

    Parameters
    ----------
    n_loops : int
        As many loops of a cloud, longest lifetime first; for those that it has not there are zeros.
    n_dims : int
        Coordinates of a point, where each cloud is a row (x, y, z, x, y, z, ...).
    n_jobs : int, optional
        Threads; by default one for each core.

    Examples
    --------
    >>> from topokit.compat import LoopFeatures
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> LoopFeatures(n_loops=1).fit_transform([square, 2 * square, square[:3]]).round(3)
    array([[0.5  , 0.207],
           [1.   , 0.414],
           [0.   , 0.   ]])
    """

    def __init__(self, n_loops: int = 4, n_dims: int = 3, n_jobs: int | None = None) -> None:
        self.n_loops, self.n_dims, self.n_jobs = n_loops, n_dims, n_jobs

    def fit(self, X: Any, y: object = None) -> LoopFeatures:
        """Look at the parameters, and at how long a row is: nothing is learned.

        Parameters
        ----------
        X, y
            As of `transform`; nothing.
        """
        whole(self.n_loops, "n_loops", 1)
        self._clouds(X, reset=True)
        return self

    def transform(self, X: Any) -> NDArray[np.float64]:
        """Return (m, 2 * n_loops): birth and lifetime, half lengths of edges, of the longest-lived loop, of the next, and so on.

        Parameters
        ----------
        X : list of (n, d) array_like, (m, n, d) array_like or (m, n * n_dims) array_like
            Clouds, each of as many points as it has; or each a row.
        """
        bars = self.diagrams(X)
        rows = np.zeros((len(bars), self.n_loops, 2))
        for row, some in zip(rows, bars, strict=True):
            row[: len(some)] = some[: self.n_loops]
            row[:, 1] -= row[:, 0]
        return rows.reshape(len(rows), -1)

    def diagrams(self, X: Any) -> list[NDArray[np.float64]]:
        """Return for each cloud its loops (k, 2), birth and death, as persim plots and compares them.

        Parameters
        ----------
        X
            As of `transform`.
        """
        found = rips_persistence_many(self._clouds(X, reset=False), self.n_jobs)
        return [np.column_stack([diagram.birth, diagram.death]) for diagram in found]

    def get_feature_names_out(self, input_features: object = None) -> NDArray[np.object_]:
        """Return what the columns are: birth0, lifetime0, birth1, and so on; `input_features` is not looked at."""
        return np.array([f"{name}{i}" for i in range(self.n_loops) for name in ("birth", "lifetime")], dtype=object)

    def _clouds(self, X: Any, reset: bool) -> list[NDArray[np.float64]]:
        """Clouds as they are given, or from the rows of an array that scikit-learn has checked."""
        if isinstance(X, (list, tuple, np.ndarray)) and len(X) and np.ndim(X[0]) == 2:
            return as_sequence(X, "X")
        rows = validate_data(self, X, reset=reset, dtype=np.float64)
        n_dims = whole(self.n_dims, "n_dims", 1)
        if rows.shape[1] % n_dims:
            raise ValueError(f"a row of X has {rows.shape[1]} numbers: no points of n_dims={n_dims} coordinates")
        return list(rows.reshape(len(rows), -1, n_dims))

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.requires_fit = False
        tags.input_tags.three_d_array = True
        tags.transformer_tags.preserves_dtype = ["float64"]
        return tags
