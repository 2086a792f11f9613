"""Load the tracker and its compiled kernels: the fork server imports this module before it forks processes that label."""

import numpy as np

from topokit.seqph import track

from . import _label  # noqa: F401

track(np.random.default_rng(0).random((2, 20, 3)), n_jobs=1)
