"""A simplex tree of GUDHI as a diagram. Nothing of GUDHI is imported: the tree brings its methods."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array

from topokit._validate import WrongKindError
from topokit.rips import Diagram, rips_persistence

from ._ripser import filled


def from_gudhi(tree: Any) -> Diagram:
    """Compute the loops of a ``gudhi.SimplexTree`` that is a Rips complex, or the graph of one.

    Parameters
    ----------
    tree : gudhi.SimplexTree
        Vertices 0 to n - 1, which enter at 0; other simplices enter with their longest edge. One of dimension 1 stands for its
        expansion.

    Returns
    -------
    Diagram
        Births and deaths are half the filtration values. Loops that the complex does not fill have death inf.

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
    if not hasattr(tree, "prune_above_dimension"):
        raise WrongKindError(f"tree must be a gudhi.SimplexTree, not {type(tree).__name__}")
    graph = tree.copy()
    graph.prune_above_dimension(1)
    simplices = list(graph.get_filtration())
    vertices = {simplex[0]: value for simplex, value in simplices if len(simplex) == 1}
    if sorted(vertices) != list(range(len(vertices))) or any(vertices.values()):
        raise ValueError("tree must have the vertices 0 to n - 1, and they must enter at 0: number them anew")
    ends = np.array([simplex for simplex, _ in simplices if len(simplex) == 2], np.int64).reshape(-1, 2)
    lengths = [value for simplex, value in simplices if len(simplex) == 2]
    if tree.dimension() > 1:
        graph.expansion(tree.dimension())
        if graph != tree:
            words = "some simplex is missing, or enters later than its longest edge; give its graph alone"
            raise ValueError(f"tree is no Rips complex: {words} (prune_above_dimension(1))")
    distances, longest = filled(coo_array((lengths, ends.T), (len(vertices),) * 2), "the edges")
    return rips_persistence(distances, metric="precomputed", max_radius=longest / 2)
