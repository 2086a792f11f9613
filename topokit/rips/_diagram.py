"""The degree-1 persistence diagram with the simplices that create and end each loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Diagram"]


@dataclass(frozen=True, eq=False)
class Diagram:
    """Degree-1 Rips persistence of a point cloud or a distance matrix, longest lifetime first.

    Filtration values are half the diameter of a simplex, in the unit of the points. A loop that `max_radius` keeps from
    dying has death inf and -1 for its killer's vertices.

    Attributes
    ----------
    birth, death : (n,) float64
    birth_edge, killer_edge : (n, 2) int64
        Vertex ids, the smaller first. `birth` and `death` are half their lengths.
    killer_triangles : (n, 2, 3) int64
        The killer edge and an apex, twice: one apex from each of the two components of the lune that the killing relation
        joins. The thick triangle, whose apex is farther from the edge's farther end, comes first.
    n_points : int
    max_radius : float
    """

    birth: NDArray[np.float64]
    death: NDArray[np.float64]
    birth_edge: NDArray[np.int64]
    killer_edge: NDArray[np.int64]
    killer_triangles: NDArray[np.int64]
    n_points: int
    max_radius: float
    _points: NDArray[np.float64]  # (n_points, d) coordinates, or the (n_points, n_points) distances
    _precomputed: bool = False

    def __post_init__(self) -> None:
        for name in ("birth", "death", "birth_edge", "killer_edge", "killer_triangles"):
            getattr(self, name).setflags(write=False)

    def __len__(self) -> int:
        return len(self.birth)

    def __repr__(self) -> str:
        longest = f", longest lifetime {self.lifetime[0]:.4g}" if len(self) else ""
        return f"Diagram({len(self)} loops of {self.n_points} points{longest})"

    @property
    def lifetime(self) -> NDArray[np.float64]:
        """(n,) death - birth."""
        return self.death - self.birth

    def distances_from(self, i: int) -> NDArray[np.float64]:
        """(n_points,) distances from vertex `i` to every vertex."""
        if self._precomputed:
            return np.asarray(self._points[i])
        return np.asarray(np.sqrt(((self._points - self._points[i]) ** 2).sum(axis=1)))

    def neighbours(self, i: int) -> NDArray[np.int64]:
        """Triangles next to the killer triangles of loop `i`: on each of their four outer edges the one that comes first.

        Returns
        -------
        (m, 3) int64, m <= 4
            Outer edge and apex, in the order of the outer edges (thick triangle first). Ties go to the smaller apex; a
            triangle that is not in the complex at the loop's death is left out. None for a loop that does not die.

        Raises
        ------
        IndexError
            When there is no loop `i`.
        """
        if not -len(self) <= i < len(self):
            raise IndexError(f"no loop {i}: the diagram has {len(self)}")
        found: list[tuple[int, int, int]] = []
        if np.isinf(self.death[i]):
            return np.empty((0, 3), dtype=np.int64)
        for x, y, apex in self.killer_triangles[i].tolist():
            for a, b, opposite in ((x, apex, y), (apex, y, x)):
                to_a, to_b = self.distances_from(a), self.distances_from(b)
                enters = np.maximum(np.maximum(to_a, to_b), to_a[b])
                enters[[a, b, opposite]] = np.inf
                c = int(np.argmin(enters))
                if enters[c] <= 2 * self.death[i]:
                    found.append((a, b, c))
        return np.array(found, dtype=np.int64).reshape(-1, 3)

    def value(self, simplex: NDArray[np.int64]) -> float:
        """Filtration value of a simplex, given by its vertex ids: half its longest edge."""
        return max(float(self.distances_from(int(v))[simplex].max()) for v in simplex) / 2
