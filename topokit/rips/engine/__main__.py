"""Compile the engine into the user's cache: ``python -m topokit.rips.engine``."""

import numpy as np

from .pairing import pair_edges

pair_edges(np.zeros((4, 3)), 0.0, np.zeros(1, np.int64))
