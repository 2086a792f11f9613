"""topokit: sequential topology for deformable objects.

Loops of point clouds by exact Vietoris-Rips persistence, located by the edge that kills them and followed through time.

    >>> import topokit as tk
    >>> tk.rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    Diagram(1 loops of 4 points, longest lifetime 0.4142)
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from .linking import linking_number
    from .mixture import LoopMixture, loop_mixture
    from .rips import Diagram, rips_persistence, rips_persistence_many
    from .sampling import covering_radius, farthest_point_sample, hausdorff
    from .seqph import Loop, SeqPH, TopologicalState, follow, track

__version__ = "0.4.0"
__getattr__, __dir__, __all__ = attach(__name__, __file__)
