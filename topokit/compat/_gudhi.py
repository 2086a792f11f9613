"""A simplex tree of GUDHI as a diagram. Nothing of GUDHI is imported: the tree brings its methods.

Source: Boissonnat, Maria 2014, *The simplex tree*; Maria, Boissonnat, Glisse, Yvinec 2014, *The GUDHI library*.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from topokit._validate import WrongKindError
from topokit.rips import Diagram, rips_persistence

from ._matrices import filled


def from_gudhi(tree: Any) -> Diagram:
    """Compute the loops of a ``gudhi.SimplexTree`` that a graph fills, as a Rips complex.

    A tree of dimension 1 is a graph, and stands for all the simplices that its expansion would have. Of a larger tree the
    triangles are compared with those.

    Parameters
    ----------
    tree : gudhi.SimplexTree
        Vertices 0 to n - 1, which enter at 0; other simplices enter with their longest edge.

    Returns
    -------
    Diagram
        Births and deaths are half the filtration values, as everywhere in topokit. Loops that the tree does not fill stay.

    Raises
    ------
    TypeError, ValueError
        When it is no simplex tree, or not of this kind.

    Examples
    --------
    >>> import gudhi
    >>> from topokit.compat import from_gudhi
    >>> corners = [[0, 0], [2, 0], [2, 2], [0, 2]]
    >>> from_gudhi(gudhi.RipsComplex(points=corners).create_simplex_tree(max_dimension=2)).birth
    array([1.])
    """
    if not hasattr(tree, "get_skeleton"):
        raise WrongKindError(f"tree must be a gudhi.SimplexTree, not {type(tree).__name__}")
    simplices = list(tree.get_skeleton(2))
    vertices = sorted(simplex[0] for simplex, _ in simplices if len(simplex) == 1)
    if vertices != list(range(len(vertices))):
        raise ValueError(
            f"tree must have the vertices 0 to n - 1, not {vertices[:3]} to {vertices[-1]}: number them anew"
        )
    late = [simplex for simplex, value in simplices if len(simplex) == 1 and value != 0]
    if late:
        raise ValueError(f"vertex {late[0][0]} does not enter at 0: topokit takes Rips complexes, not lower stars")
    matrix = np.full((len(vertices), len(vertices)), np.inf)
    np.fill_diagonal(matrix, 0.0)
    for simplex, value in simplices:
        if len(simplex) == 2:
            a, b = simplex
            matrix[a, b] = matrix[b, a] = value
    if tree.dimension() > 1:
        _check_triangles(matrix, simplices)
    distances, longest = filled(matrix, "the edges")
    return rips_persistence(distances, metric="precomputed", max_radius=longest / 2)


def _check_triangles(matrix: Any, simplices: list[tuple[list[int], float]]) -> None:
    """Raise ValueError when a triangle of the graph is missing, or enters later than its longest edge."""
    count = 0
    for simplex, value in simplices:
        if len(simplex) == 3:
            count += 1
            if value != matrix[np.ix_(simplex, simplex)].max():
                raise ValueError(f"triangle {simplex} enters at {value}, not with its longest edge: no Rips complex")
    graph = np.isfinite(matrix).astype(np.float64) - np.eye(len(matrix))
    there = round(float((graph @ graph * graph).sum()) / 6)
    if there != count:
        raise ValueError(
            f"tree has {count} of the {there} triangles of its graph: no Rips complex; give its edges alone"
        )
