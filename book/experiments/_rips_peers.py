"""What the benchmark of persistence compares with: the libraries that are installed, and the floor that none can pass.

Every peer is a function of the points, or of a matrix of distances, and returns the bars of degree 1 as lengths of edges. Each is
called in the way that is fastest for it: with lengths computed by SciPy where it would compute them more slowly, and up to the
radius at which the complex is a cone, unless it finds that itself. It is imported when it is first called, so it may be missing.
"""

from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist, squareform

import topokit as tk

Array = NDArray[np.float64]
Bars = Callable[[Array, bool], Array]


def redzed(data: Array, is_matrix: bool) -> Array:
    """Compute bars by redzed-tda, without their simplices, from the lengths of pairs."""
    import redzed_tda

    return redzed_tda.rips(data if is_matrix else pdist(data), 1)[1]


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

    matrix = data if is_matrix else squareform(pdist(data))
    longest = matrix.max(axis=1).min()  # where one point is joined to all others, no loop is left
    rips = gudhi.RipsComplex(distance_matrix=matrix, max_edge_length=longest)
    tree = rips.create_simplex_tree(max_dimension=1)
    tree.collapse_edges()
    tree.expansion(2)
    tree.compute_persistence(homology_coeff_field=2)
    return tree.persistence_intervals_in_dimension(1)


def gudhi_rips(data: Array, is_matrix: bool) -> Array:
    """Compute bars by GUDHI's `RipsPersistence`, which chooses among its ways."""
    from gudhi.sklearn import RipsPersistence

    kind = "full distance matrix" if is_matrix else "point cloud"
    way = RipsPersistence(homology_dimensions=1, homology_coeff_field=2, input_type=kind, n_jobs=1)
    return way.fit_transform([data])[0]


def ripser(data: Array, is_matrix: bool) -> Array:
    """Compute bars by ripser.py."""
    import ripser

    return ripser.ripser(data, maxdim=1, distance_matrix=is_matrix)["dgms"][1]


# The module of each peer and its bars, the fastest first.
PEERS: dict[str, tuple[str, Bars]] = {
    "redzed-tda": ("redzed_tda", redzed),
    "tda": ("tda", rust_tda),
    "holos-tda": ("holos_tda", holos),
    "giotto-ph": ("gph", giotto),
    "GUDHI": ("gudhi", gudhi_rips),
    "GUDHI, collapsed": ("gudhi", gudhi_collapsed),
    "ripser.py": ("ripser", ripser),
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
def _read_points(x: Array, y: Array, z: Array, ends: NDArray[np.int64], longest: float) -> int:
    """Count short pairs; the points that can be near enough to the i-th end before `ends[i]`."""
    count = 0
    for i in range(len(x)):
        for j in range(i + 1, ends[i]):
            count += (x[j] - x[i]) ** 2 + (y[j] - y[i]) ** 2 + (z[j] - z[i]) ** 2 <= longest * longest
    return count


def floor(points: Array, longest: float) -> Callable[[], int]:
    """Return a pass that computes the length of every pair in space that may be as short as `longest`, and nothing else.

    A sweep along the longest axis leaves out what is too far apart along it; what sorting them costs is not in the pass.
    """
    points = points[:, np.argsort(-np.ptp(points, axis=0))]
    points = points[np.argsort(points[:, 0])]
    ends = np.searchsorted(points[:, 0], points[:, 0] + longest, side="right")
    columns = np.ascontiguousarray(points.T)
    return lambda: _read_points(*columns, ends, longest)
