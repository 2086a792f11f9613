"""seqPH: states of a scene, and the tracker that follows loops through a sequence of point clouds.

Idea: a state is the list of loops of one frame. The tracker finds the loops by Rips persistence and decides which of them is
which of the frame before. `follow` needs no matching: it moves tracked loops along with the points of their cloud.

Source: Antonova et al. 2021, section 4 and Algorithm 1. Taught in chapters 0, 7 and 14.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._follow import follow
    from ._matching import assign
    from ._state import Loop, TopologicalState
    from ._tracker import PAPER, SeqPH, track

__getattr__, __dir__, __all__ = attach(__name__, __file__)
