"""Births and deaths that PyTorch differentiates: each is half the length of an edge, and an edge has two ends.

Idea: which edges these are does not change under small motions of the points, almost everywhere; so the gradient of a bar is
that of the lengths of its birth edge and its killer edge.

Source: Gameiro, Hiraoka, Obayashi 2016, *Continuation of point clouds via persistence diagrams*.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from topokit._validate import WrongKindError, whole
from topokit.rips import Diagram, rips_persistence_many


def births_and_deaths(points: Tensor, n_loops: int | None = None, *, n_jobs: int | None = None) -> Tensor:
    """Compute births and deaths of the loops of clouds, as functions of the points.

    Parameters
    ----------
    points : (n, d) or (batch, n, d) Tensor
        On any device; persistence itself is computed on the processor.
    n_loops : int, optional
        So many of each cloud, longest lifetime first; by default as many as the cloud with the most. Missing ones are (0, 0),
        and their derivatives are 0.
    n_jobs : int, optional
        Threads for a batch; by default one for each core.

    Returns
    -------
    (n_loops, 2) or (batch, n_loops, 2) Tensor
        Birth and death, of the type and on the device of the points.

    Raises
    ------
    TypeError, ValueError
        When `points` is no tensor of clouds, or holds a NaN or an infinite coordinate.

    Examples
    --------
    A square, seen as a loop: it dies later when its first diagonal grows.

    >>> import torch
    >>> from topokit.compat import births_and_deaths
    >>> points = torch.tensor([[0.0, 0], [2, 0], [2, 2], [0, 2]], requires_grad=True)
    >>> birth, death = births_and_deaths(points)[0]
    >>> death.backward()
    >>> points.grad[2]
    tensor([0.3536, 0.3536])
    """
    if not isinstance(points, Tensor):
        raise WrongKindError(f"points must be a tensor, not {type(points).__name__}")
    if not points.is_floating_point():
        raise WrongKindError(f"points must be a tensor of floating point, not of {points.dtype}")
    if points.ndim not in (2, 3):
        raise ValueError(f"points must be of shape (n, d) or (batch, n, d), not {tuple(points.shape)}")
    if points.ndim == 2:
        return births_and_deaths(points[None], n_loops, n_jobs=n_jobs)[0]
    if not len(points):
        raise ValueError(f"points holds no cloud: its shape is {tuple(points.shape)}")

    # Which edges create and end the loops; nothing of this is differentiated.
    diagrams = rips_persistence_many(points.detach().cpu().double().numpy(), n_jobs)
    if n_loops is None:
        n_loops = max(map(len, diagrams), default=0)
    n_loops = whole(n_loops, "n_loops")
    edges = torch.from_numpy(np.stack([_edges(diagram, n_loops) for diagram in diagrams])).to(points.device)

    # Half the lengths of these edges, as functions of their ends.
    clouds = torch.arange(len(points), device=points.device)[:, None, None, None]
    ends = points[clouds, edges]  # (batch, n_loops, 2, 2, d)
    sides = ends[..., 0, :] - ends[..., 1, :]

    # The second derivative of a norm is not defined at 0. The length of an edge from a vertex to itself is the constant 0.
    is_zero = torch.linalg.vector_norm(sides.detach(), dim=-1) == 0
    lengths = torch.linalg.vector_norm(torch.where(is_zero[..., None], 1.0, sides), dim=-1)
    return torch.where(is_zero, 0.0, lengths) / 2


def _edges(diagram: Diagram, n: int) -> np.ndarray:
    """Return the (n, 2, 2) birth and killer edges of the first loops; a missing one is an edge from a vertex to itself."""
    edges = np.stack([diagram.birth_edge, diagram.killer_edge], axis=1)[:n]
    missing = np.zeros((n - len(edges), 2, 2), np.int64)
    return np.concatenate([edges, missing])
