"""The starts of a benchmark, one after another, for whoever learns on them or is judged by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium

from topokit._validate import whole


class HangingStarts(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Episodes of a `HangEnv` that start where those of the hanging benchmark do (`book/experiments/hanging.py`).

    Each `reset` takes the next seed, and after the last one the first again; ``reset(seed=k)`` goes on from the k-th.

    Parameters
    ----------
    env : gymnasium.Env
        Made by its id: the target is anywhere then, as in the benchmark.
    seeds : sequence of int
        Those of the benchmark when not given. Learn on others: ``range(1000)``.

    Examples
    --------
    >>> import gymnasium
    >>> from topokit.sim import HangingStarts
    >>> env = HangingStarts(gymnasium.make("topokit/HangApronHook-v1"), seeds=range(1000))
    """

    def __init__(self, env: gymnasium.Env[Any, Any], seeds: Sequence[int] = range(1000, 1050)) -> None:
        super().__init__(env)
        self.seeds, self._next = [whole(seed, "a seed") for seed in seeds], 0
        if not self.seeds:
            raise ValueError("seeds must hold a seed; leave it out for those of the benchmark")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the next episode; `info` tells its ``seed``.

        Parameters
        ----------
        seed : int, optional
            Which of the starts comes next, counted from 0 and around.
        options : dict, optional
            Those of `HangEnv.reset`.
        """
        place = (self._next if seed is None else seed) % len(self.seeds)
        self._next = place + 1
        observation, info = self.env.reset(seed=self.seeds[place], options=options)
        return observation, {**info, "seed": self.seeds[place]}
