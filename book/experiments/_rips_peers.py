"""What the benchmark of persistence compares with: the libraries that are installed, and the floor that none can pass.

Every peer is a function of the points, or of a matrix of distances, and returns the bars of degree 1 as lengths of edges. Each is
called in the way that is fastest for it: with a matrix made by SciPy where it would make its own more slowly, and up to the
radius at which the complex is a cone, unless it finds that itself.
"""

from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.spatial.distance import pdist, squareform

import topokit as tk

Array = NDArray[np.float64]
Bars = Callable[[Array, bool], Array]


def distances(data: Array, is_matrix: bool) -> Array:
    """Return the square matrix of distances."""
    if is_matrix:
        return data
    return squareform(pdist(data))


def enclosing_radius(matrix: Array) -> float:
    """Return the length at which one point is joined to all others: no loop lives longer."""
    return float(matrix.max(axis=1).min())


# Peers are imported when they are first called, so that each can be missing.


def redzed(data: Array, is_matrix: bool) -> Array:
    """Compute bars by redzed-tda."""
    import redzed_tda

    return redzed_tda.rips(distances(data, is_matrix), 1)[1]


def rust_tda(data: Array, is_matrix: bool) -> Array:
    """Compute bars by tda, on single precision."""
    import tda

    return tda.persistent_homology(data.astype(np.float32), 1, distance_matrix=is_matrix, parallel=False)[1]


def holos(data: Array, is_matrix: bool) -> Array:
    """Compute bars by holos-tda."""
    import holos_tda

    found = holos_tda.rips_condensed(squareform(data), 1) if is_matrix else holos_tda.rips_points(data, 1)
    return np.array([bar[1:3] for bar in found if bar[0] == 1]).reshape(-1, 2)


def giotto(data: Array, is_matrix: bool) -> Array:
    """Compute bars by giotto-ph."""
    from gph import ripser_parallel

    metric = "precomputed" if is_matrix else "euclidean"
    return ripser_parallel(data, maxdim=1, n_threads=1, metric=metric)["dgms"][1]


def gudhi_collapsed(data: Array, is_matrix: bool) -> Array:
    """Compute bars by GUDHI after collapsing edges."""
    import gudhi

    matrix = distances(data, is_matrix)
    rips = gudhi.RipsComplex(distance_matrix=matrix, max_edge_length=enclosing_radius(matrix))
    tree = rips.create_simplex_tree(max_dimension=1)
    tree.collapse_edges()
    tree.expansion(2)
    tree.compute_persistence(homology_coeff_field=2)
    return tree.persistence_intervals_in_dimension(1)


def ripser_dense(data: Array, is_matrix: bool) -> Array:
    """Compute bars by ripser.py on all pairs."""
    import ripser

    return ripser.ripser(data, maxdim=1, distance_matrix=is_matrix)["dgms"][1]


def _sparse_bars(matrix: Array, longest: float) -> Array:
    """Compute bars by Ripser on a sparse matrix of the edges that are short enough."""
    import ripser

    i, j = np.nonzero(np.triu(matrix <= longest, 1))
    edges = coo_matrix((matrix[i, j], (i, j)), matrix.shape)
    return ripser.ripser(edges, maxdim=1, distance_matrix=True)["dgms"][1]


def ripser_sparse(data: Array, is_matrix: bool) -> Array:
    """Compute bars by Ripser up to the enclosing radius."""
    matrix = distances(data, is_matrix)
    return _sparse_bars(matrix, enclosing_radius(matrix))


def ripser_told(data: Array, is_matrix: bool) -> Array:
    """Compute bars by Ripser up to the last death, which topokit computes once for each cloud, outside of the time."""
    key = data.tobytes()
    if key not in _last_deaths:
        _last_deaths[key] = last_death(data, is_matrix) * (1 + 1e-6)
    return _sparse_bars(distances(data, is_matrix), _last_deaths[key])


_last_deaths: dict[bytes, float] = {}
# The module of each peer and its bars, the fastest first.
PEERS: dict[str, tuple[str, Bars]] = {
    "redzed-tda": ("redzed_tda", redzed),
    "tda": ("tda", rust_tda),
    "holos-tda": ("holos_tda", holos),
    "giotto-ph": ("gph", giotto),
    "GUDHI, collapsed": ("gudhi", gudhi_collapsed),
    "ripser.py": ("ripser", ripser_dense),
    "Ripser, sparse": ("ripser", ripser_sparse),
    "Ripser, told the end": ("ripser", ripser_told),
}
NAMES = tuple(PEERS)


def installed() -> dict[str, Bars]:
    """Return the peers that are installed by name, the fastest first."""
    return {name: bars for name, (module, bars) in PEERS.items() if find_spec(module)}


def versions() -> dict[str, str]:
    """Return the versions of topokit, of what it needs, and of the peers that are installed."""
    found = {"topokit": tk.__version__}
    for module in ("numpy", "scipy", "numba", *(module for module, _ in PEERS.values())):
        if find_spec(module):
            name = {"gph": "giotto-ph"}.get(module, module)
            found[name] = version(name)
    return found


def ours(data: Array, is_matrix: bool) -> tk.rips.Diagram:
    """Compute bars by topokit."""
    return tk.rips_persistence(data, metric="precomputed" if is_matrix else "euclidean")


def last_death(data: Array, is_matrix: bool = False) -> float:
    """Return the length of the edge that kills the last loop."""
    return float(2 * ours(data, is_matrix).death.max(initial=0.0))


@numba.njit
def _read_matrix(matrix: Array, longest: float) -> int:
    count = 0
    for i in range(len(matrix)):
        for j in range(i + 1, len(matrix)):
            count += matrix[i, j] <= longest
    return count


@numba.njit
def _read_points(columns: Array, ends: Any, longest: float) -> int:
    """`columns` (d, n), in the order of the first; the points that can be near enough to the i-th end before `ends[i]`."""
    count = 0
    square = longest * longest
    if len(columns) == 3:
        x, y, z = columns
        for i in range(len(x)):
            for j in range(i + 1, ends[i]):
                count += (x[j] - x[i]) ** 2 + (y[j] - y[i]) ** 2 + (z[j] - z[i]) ** 2 <= square
        return count
    total = np.empty(columns.shape[1])
    for i in range(columns.shape[1]):
        total[i + 1 : ends[i]] = 0.0
        for k in range(len(columns)):
            column = columns[k]
            for j in range(i + 1, ends[i]):
                total[j] += (column[j] - column[i]) ** 2
        for j in range(i + 1, ends[i]):
            count += total[j] <= square
    return count


def floor(data: Array, is_matrix: bool, longest: float) -> Callable[[], int]:
    """Return a pass that computes the length of every pair that may be as short as `longest`, and nothing else; it counts them.

    A sweep along the longest axis leaves out what is too far apart along it; what sorting them costs is not in the pass.
    """
    if is_matrix:
        return lambda: _read_matrix(data, longest)
    points = data[:, np.argsort(-np.ptp(data, axis=0))]
    points = points[np.argsort(points[:, 0])]
    ends = np.searchsorted(points[:, 0], points[:, 0] + longest, side="right")
    columns = np.ascontiguousarray(points.T)
    return lambda: _read_points(columns, ends, longest)
