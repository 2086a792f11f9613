"""The pairs of edges that create and kill the loops of clouds, by the compiled kernel or without a compiler.

Idea: compiling takes as long as thousands of small clouds take in plain Python. So clouds are paired by `_plain` until that would
have cost as much as compiling, in this process and those before it, or, where compiled code is kept from another time, as loading
it. From then on the kernel is used. This costs at most twice what the better choice would have cost, whatever clouds come (Karlin
et al. 1988, the rent of skis). Both ways return the same pairs to the last bit.

The kernel runs without Python's lock, in threads that share the clouds. The main thread, which alone hears Ctrl-C, never runs it:
it waits for another thread, and ends the run through the array `stop`, which the kernel reads at every edge. An interrupt in the
main thread while numba makes Python's objects of what the kernel returns would crash the process.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent import futures
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._validate import Array, Ids
from . import _cloud, _numba, _plain
from ._cloud import Cloud, too_large

LONG = 2000  # points that can take a second
LARGE = 16_000  # points of a cloud that is paired without a bit for each pair of points
COMPILING = 20.0  # seconds of a processor that compiling takes
LOADING = 0.7  # and loading what is compiled, numba included
_PATIENCE = 3.0  # seconds before what takes long is announced
_STOPPED = 1  # what a thread writes into the flag `stop` of another one; the kernel writes other numbers
CLOUDS = "pair_clouds"  # the two functions of the kernel: for clouds of points and for a matrix of distances,
LARGE_CLOUD = "pair_large"  # and for a large cloud of points
_ready: set[str] = set()  # those that are loaded
_spent = 0.0  # seconds that plain Python has taken in their place in this process
_choosing = threading.RLock()
_worker = futures.ThreadPoolExecutor(1)  # the thread that works for the main thread
_thread = threading.local()  # each thread keeps its buffer for edges from one cloud to the next


class Pairs(NamedTuple):
    """Loops by birth, short ones too. Radii are in the scaled unit of the cloud."""

    created: Ids  # (c, 2) edges that create loops, the smaller vertex first
    killed: Ids  # (c, 4) killer edges, the smaller vertex first, with their two apexes; -1 for none
    birth: Array  # (c,)
    death: Array  # (c,)


def new_stop() -> NDArray[np.int64]:
    """Return a flag that ends runs when it is passed to `stop_run`."""
    return np.zeros(1, np.int64)


def stop_run(stop: NDArray[np.int64]) -> None:
    """Let a run in another thread end."""
    stop[0] = _STOPPED


def pairs(cloud: Cloud, max_radius: float, stop: NDArray[np.int64] | None = None) -> Pairs:
    """Pair the edges of a cloud up to a scaled radius.

    With `stop` the caller is a thread that another one can end.
    """
    if len(cloud) < 4 or (cloud.axes and not cloud.data[:, 1:].any()):  # on a line
        return Pairs(np.empty((0, 2), np.int64), np.empty((0, 4), np.int64), np.empty(0), np.empty(0))
    n = len(cloud)
    is_large = n >= LARGE and bool(cloud.axes)
    if not compiled_pays([n], LARGE_CLOUD if is_large else CLOUDS):
        return _pairs_in_plain_python(cloud, max_radius, stop)
    if not is_large:
        return _pairs_of_kernel([cloud], [max_radius], stop)[0]
    created, killed, repeated = _run(LARGE_CLOUD, (cloud.data, cloud.key_of(max_radius)), n, stop)
    if repeated:
        return _pairs_without_repeats(cloud, max_radius, stop)
    return _cut(cloud, created, killed, max_radius)[0]


def pairs_of_many(clouds: Sequence[Cloud], max_radius: float, stop: NDArray[np.int64] | None = None) -> list[Pairs]:
    """Pair the edges of each cloud up to a radius in the unit of the points, short clouds in one compiled call."""
    bounds = [max_radius * cloud.scale for cloud in clouds]
    sizes = [len(cloud) for cloud in clouds]
    if not clouds[0].axes or not 4 <= max(sizes) < LONG or not compiled_pays(sizes):
        return [pairs(cloud, bound, stop) for cloud, bound in zip(clouds, bounds, strict=True)]
    return _pairs_of_kernel(clouds, bounds, stop)


def _pairs_of_kernel(clouds: Sequence[Cloud], bounds: Sequence[float], stop: NDArray[np.int64] | None) -> list[Pairs]:
    """Pair the edges of clouds of points, or of one matrix, each up to a scaled radius."""
    stack = clouds[0]
    if len(clouds) > 1:
        stack = Cloud(np.concatenate([cloud.data for cloud in clouds]), stack.axes, 1.0)
    starts = np.cumsum([0, *map(len, clouds)])
    lengths = np.array([stack.key_of(bound) for bound in bounds])
    created, killed, counts = _run(CLOUDS, (stack.data, starts, lengths), max(map(len, clouds)), stop)

    # All clouds at once, and then the rows of each.
    number = np.repeat(np.arange(len(clouds)), np.maximum(counts, 0))
    table, inside = _cut(stack, created, killed, np.array(bounds)[number], starts[number, None])
    ends = np.searchsorted(number[inside], np.arange(len(clouds) + 1)).tolist()
    found = [Pairs._make(column[a:b] for column in table) for a, b in pairwise(ends)]
    for c in np.flatnonzero(counts < 0).tolist():
        found[c] = _pairs_without_repeats(clouds[c], bounds[c], stop)
    return found


def _pairs_in_plain_python(cloud: Cloud, max_radius: float, stop: NDArray[np.int64] | None) -> Pairs:
    global _spent
    start = time.thread_time()
    created, killed = _plain.pair_edges(cloud, cloud.key_of(max_radius), new_stop() if stop is None else stop)
    with _choosing:
        if not _spent:
            atexit.register(keep_seconds)
        _spent += time.thread_time() - start
    return _cut(cloud, created, killed, max_radius)[0]


def keep_seconds() -> None:
    """Let the next process know the seconds of plain Python, until the kernel is compiled."""
    if _spent >= LOADING and _numba.is_usable() and not _ready:
        _numba.add_seconds(_spent)


def _pairs_without_repeats(cloud: Cloud, bound: float, stop: NDArray[np.int64] | None) -> Pairs:
    """Pair the edges between first copies of points.

    Edges of a second copy have cones over the first for lunes, and the edge between the copies closes nothing.
    """
    first = np.sort(np.unique(cloud.data + 0.0, axis=0, return_index=True)[1])
    created, killed, birth, death = pairs(Cloud(cloud.data[first], cloud.axes, cloud.scale), bound, stop)
    number = np.append(first, -1)
    return Pairs(number[created], number[killed], birth, death)


def _cut(cloud: Cloud, created: Ids, killed: Ids, bound: Any, offset: Any = 0) -> tuple[Pairs, NDArray[np.bool_]]:
    """Return the pairs born by a bound and killed by then or never, and which those are; `offset` is added to vertex ids."""
    created.sort()
    killed[:, :2].sort()
    ends = np.stack([created, killed[:, :2]]) + offset
    birth, death = cloud.radii(ends[..., 0], ends[..., 1])
    death[(killed[:, 0] < 0) | (death > bound)] = np.inf
    killed[np.isinf(death)] = -1
    inside = birth <= bound
    return Pairs(created[inside], killed[inside], birth[inside], death[inside]), inside


def _run(function: str, arguments: tuple[Any, ...], n: int, stop: NDArray[np.int64] | None) -> Any:
    """Run a function of the kernel on clouds of up to n points, without `stop` not in the main thread."""
    if stop is not None or threading.current_thread() is not threading.main_thread():
        return _run_here(function, arguments, n, new_stop() if stop is None else stop)
    stop = new_stop()
    try:
        return _worker.submit(_run_here, function, arguments, n, stop).result()
    except BaseException:  # Ctrl-C, for example
        stop_run(stop)
        raise


def _replace_worker() -> None:
    global _worker
    _worker = futures.ThreadPoolExecutor(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_replace_worker)  # a forked process has no thread but its main thread


def _run_here(function: str, arguments: tuple[Any, ...], n: int, stop: NDArray[np.int64]) -> Any:
    from . import kernel

    # What is kept of each point, or of each pair of points; edges and loops come on top.
    tables = kernel.BYTES_A_POINT * n if function == LARGE_CLOUD else n * ((n + 63) // 64) * 8
    spare = _cloud.MEMORY - tables
    if spare < 0:
        raise too_large(n, f"{(tables + kernel.EDGE_BYTES * kernel.WINDOW) / 1e9:.1f} GB")
    buffer = getattr(_thread, "buffer", None)
    if buffer is None or kernel.EDGE_BYTES * len(buffer[0]) > spare // 2:
        buffer = tuple(kernel.new_buffer(min(1 << 16, spare // (2 * kernel.EDGE_BYTES))))
    buffer, *found = getattr(kernel, function)(*arguments, buffer, spare, stop)
    if stop[0] == _STOPPED:
        raise futures.CancelledError
    if stop[0] == kernel.TOO_MANY_EDGES:
        raise too_large(n, "more: there are very many edges of the same length")
    if stop[0] == kernel.TOO_MANY_LOOPS:
        raise too_large(n, "more: there are very many loops, however short")
    _thread.buffer = buffer if len(buffer[0]) <= kernel.WINDOW else None
    return found


# The choice -----------------------------------------------------------------------------------------------------------


def compiled_pays(sizes: Sequence[int], function: str = CLOUDS) -> bool:
    """Return True if a function of the kernel is loaded, or worth loading or compiling; then this is done here.

    Parameters
    ----------
    sizes : sequence of int
        Numbers of points of the clouds to come.
    function : str
        The name of the function.
    """
    if function in _ready:
        return True
    expected = sum(map(_plain.seconds, sizes))
    with _choosing:
        cost = _spent + expected
        if cost < LOADING or not _numba.is_usable():
            if expected > _PATIENCE:
                _numba.say_once(f"without numba a cloud of {max(sizes)} points takes long, {expected:.0f} s or more")
            return False
        pays = _numba.is_compiled(function) or cost + _numba.seconds_before() >= COMPILING
        return pays and _load(function)


def _load(function: str) -> bool:
    """Compile a function of the kernel on a tiny cloud, or load it, once a process; announce it when it takes long.

    Return False where numba cannot be imported.
    """
    with _choosing:
        if function in _ready:
            return True
        what = "large clouds" if function == LARGE_CLOUD else "clouds"
        message = f"topokit: compiling the persistence kernel for {what} (once)"
        if _numba.is_compiled(function):
            message = f"topokit: loading the compiled persistence kernel for {what}"
        notice = threading.Timer(_PATIENCE, print, [message], {"file": sys.stderr, "flush": True})
        notice.start()
        try:
            if not _aside(lambda: _compiles(function)):
                return False
        finally:
            notice.cancel()
        _ready.add(function)
        return True


def _compiles(function: str) -> bool:
    """Compile or load a function of the kernel; return False where numba cannot be imported."""
    if not _numba.imports():
        return False
    tiny = Cloud(np.eye(4, 3), (0, 0, 0), 1.0)
    if function == LARGE_CLOUD:
        _run(function, (tiny.data, 1.0), 4, None)
    else:
        _pairs_of_kernel([tiny], [1.0], None)
    return True


def _aside(function: Callable[[], bool]) -> bool:
    """Call a function in a thread that does not keep the process from ending.

    In the main thread the compiler would hear Ctrl-C late, or lose it: it makes many objects whose `__del__` may not raise.
    """
    answer: futures.Future[bool] = futures.Future()

    def call() -> None:
        try:
            answer.set_result(function())
        except BaseException as error:
            answer.set_exception(error)

    threading.Thread(target=call, daemon=True).start()
    return answer.result()
