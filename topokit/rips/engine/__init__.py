"""The compiled engine of degree-1 Rips persistence: the algorithm of `topokit.rips.pairing` with less work for each edge.

Idea: most lunes are cones. One vertex near the middle of the edge is then joined to all the others, and a grid gives that vertex,
so such an edge costs one lookup. The rest is economy: bits in words of 64, edges sorted a window of lengths at a time, and an
end as soon as no later edge has an empty lune.

- `tree`: a kd-tree of the points.
- `edges`: lengths, their order, and windows of edges.
- `lunes`: bitsets, cones, connected lunes, components.
- `relations`: cycles that bound, written in creators and reduced.
- `stop`: the last edge that can create a loop.
- `pairing`: all together, `pair_edges`, the one function that Python calls.

The pairs are those of `topokit.rips.pairing` to the last bit. Numba keeps the compiled code in the user's cache folder.

Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration). Read in appendix B.
"""

import os
from typing import Any

from .._engine import cache_folder

# A file of settings in the working directory must not decide where code is loaded from; the user's environment may.
os.environ.setdefault("NUMBA_CACHE_DIR", cache_folder())
os.environ.setdefault("NUMBA_CACHE_LOCATOR_CLASSES", "")

from numba import njit

# Functions that only compiled code calls need no way in from Python, which takes a fifth of the time of compiling.
_options: Any = {"error_model": "numpy", "no_cfunc_wrapper": True, "no_cpython_wrapper": True}
compiled = njit(**_options)
inlined = njit(**_options, forceinline=True)
