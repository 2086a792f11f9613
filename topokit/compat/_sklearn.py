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
        So many loops of a cloud, longest lifetime first; a cloud that has fewer gets zeros.
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
        self.n_loops = n_loops
        self.n_dims = n_dims
        self.n_jobs = n_jobs

    def fit(self, X: Any, y: object = None) -> LoopFeatures:
        """Check the parameters and remember how long a row is; nothing is learned.

        Parameters
        ----------
        X, y
            Clouds as in `transform`; not used.
        """
        whole(self.n_loops, "n_loops", 1)
        self._clouds(X, reset=True)
        return self

    def transform(self, X: Any) -> NDArray[np.float64]:
        """Return (m, 2 * n_loops): birth and lifetime, half lengths of edges, of the longest-lived loop, of the next, and so on.

        Parameters
        ----------
        X : list of (n, d) array_like, (m, n, d) array_like or (m, n * n_dims) array_like
            Clouds, which need not have the same number of points; or a cloud in each row.
        """
        diagrams = self.diagrams(X)
        rows = np.zeros((len(diagrams), self.n_loops, 2))
        for row, bars in zip(rows, diagrams, strict=True):
            row[: len(bars)] = bars[: self.n_loops]
            row[:, 1] -= row[:, 0]  # from death to lifetime
        return rows.reshape(len(rows), -1)

    def diagrams(self, X: Any) -> list[NDArray[np.float64]]:
        """Return for each cloud its loops (k, 2), birth and death, as persim plots and compares them.

        Parameters
        ----------
        X
            Clouds as in `transform`.
        """
        diagrams = rips_persistence_many(self._clouds(X, reset=False), self.n_jobs)
        return [np.column_stack([diagram.birth, diagram.death]) for diagram in diagrams]

    def get_feature_names_out(self, input_features: object = None) -> NDArray[np.object_]:
        """Return the names of the columns: birth0, lifetime0, birth1, and so on; `input_features` is not used."""
        names = [f"{name}{i}" for i in range(self.n_loops) for name in ("birth", "lifetime")]
        return np.array(names, dtype=object)

    def _clouds(self, X: Any, reset: bool) -> list[NDArray[np.float64]]:
        """Return clouds as they are given, or from the rows of an array that scikit-learn has checked."""
        if isinstance(X, (list, tuple, np.ndarray)) and len(X) and np.ndim(X[0]) == 2:
            return as_sequence(X, "X")

        # A cloud in each row: scikit-learn's own form.
        rows = validate_data(self, X, reset=reset, dtype=np.float64)
        n_dims = whole(self.n_dims, "n_dims", 1)
        if rows.shape[1] % n_dims:
            raise ValueError(f"a row of X has {rows.shape[1]} numbers: no points of n_dims={n_dims} coordinates")
        if rows.shape[1] == n_dims > 1 and len(rows) > 1:
            question = f"X is one array {rows.shape}: is it a cloud of {len(rows)} points? Then give [X]"
            raise ValueError(f"{question}; with n_dims={n_dims} each row is a cloud of one point, which has no loop")
        return list(rows.reshape(len(rows), -1, n_dims))

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.requires_fit = False
        tags.input_tags.three_d_array = True
        tags.transformer_tags.preserves_dtype = ["float64"]
        return tags
