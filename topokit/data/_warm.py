"""Load the tracker and its compiled kernels: the fork server imports this module before it forks processes that label."""

import numpy as np

from topokit.rips import rips_persistence_many
from topokit.seqph import track

from . import _label  # noqa: F401

# For so many points the kernel is compiled, or loaded; they coincide, so that nothing is computed.
rips_persistence_many([np.zeros((10_000, 3))])
track(np.random.default_rng(0).random((2, 20, 3)), n_jobs=1)
