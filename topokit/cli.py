"""The `topokit` command, and of its parts `simulate` and `track`. What they need is imported when they run.

Exit code 0 when all is well, 1 when the work failed, 2 when the input or the call is wrong or there is no room, 130 after
Ctrl-C, 141 when nobody reads the output any more.
"""

from __future__ import annotations

import argparse
import dataclasses
import errno
import json
import math
import os
import sys
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import __version__
from ._archive import FormatError, atomic_file
from .seqph import PAPER, SeqPH, track

__all__ = ["main"]
_TASKS = """tasks, a garment and a target:
  {apron,apron2,tote,tote2,backpack,mask,sheet,sheet2}-hook
  {apron,apron2,tote,tote2,backpack,mask,sheet,sheet2}-hanger
  {apron,apron2,backpack,shirt,vest}-mannequin"""
_PICTURES = (".png", ".svg", ".pdf")
_LARGEST_FRAME = 2**28  # bytes of a cloud: eleven million points in space
_TRACKER = ("alpha", "beta", "epsilon", "loops", "gates", "identity", "memory")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (those of the process when None) and return its exit code."""
    options = parser().parse_args(arguments)
    try:
        code = int(options.run(options))
        print(end="", flush=True)  # here, where it can still be told that the output was not taken
        return code
    except ModuleNotFoundError as error:  # of a part of ours that needs more than the core
        wanted = f"{error.name} is needed, and is not there: pip install 'topokit[all]'"
        print(f"topokit {options.command}: error: {wanted}", file=sys.stderr)
        return 2
    except (ValueError, OSError, ImportError, MemoryError) as error:  # any other is a mistake of ours, and shows where
        print(f"topokit {options.command}: error: {_words(error)}", file=sys.stderr)
        return 141 if isinstance(error, BrokenPipeError) else 2
    except RuntimeError as error:  # the input was right, the work failed: a simulation that exploded
        print(f"topokit {options.command}: failed: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stopped:
        print(f"topokit {options.command}: {stopped or 'stopped; nothing was written'}", file=sys.stderr)
        return 130


def _words(error: BaseException) -> str:
    """What an error says, and what to do; where it is not told of a file, it is standard output that takes no more."""
    if not isinstance(error, OSError) or error.errno not in (errno.EPIPE, errno.ENOSPC):
        return str(error) or "not enough memory for so much at a time"
    if error.filename is None:  # what waits for it is dropped: Python would try again at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    stopped, full = "its reader has stopped, files are written", "make room, and repeat the command"
    remedy = stopped if error.errno == errno.EPIPE else full
    return f"{error.filename or 'standard output'}: {error.strerror}; {remedy}"


def parser() -> argparse.ArgumentParser:
    from .data import _commands as data
    from .evaluate import _commands as evaluate
    from .models import _commands as models

    whole = argparse.ArgumentParser(prog="topokit", description="Sequential topology for deformable objects.")
    whole.add_argument("--version", action="version", version=f"topokit {__version__}")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_simulate(commands)
    _add_track(commands)
    for part in (data, models, evaluate):
        part.add(commands)
    for command in commands.choices.values():
        command.add_argument("--json", action="store_true", help="print the answer as JSON")
    return whole


def _add_simulate(commands: Any) -> None:
    simulate = commands.add_parser(
        "simulate",
        help="record an episode: a garment carried to a target and let go there",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=_TASKS,
    )
    option = simulate.add_argument
    option("--task", default="apron-hook", help="what goes where (default apron-hook), see below")
    option("--seed", type=int, default=0, help="of everything random (default 0)")
    option("--out", type=Path, required=True, metavar="EPISODE", help="where to write it (.npz)")
    option("--randomise", action="store_true", help="draw physics, size and cameras, not only the path")
    option("--cameras", type=int, default=0, metavar="K", help="observe with K depth cameras around the target")
    option("--noise", action="store_true", help="cameras with the noise of a depth sensor")
    option("--observed", type=int, metavar="N", help="points of an observation (default 500, or all vertices if fewer)")
    patience = "stop a simulation that shows no sign of life for so many seconds (default 60)"
    option("--time-limit", type=float, default=60.0, metavar="S", help=patience)
    simulate.set_defaults(run=_simulate)


def _add_track(commands: Any) -> None:
    tracker = commands.add_parser("track", help="follow the loops of a recorded episode")
    option = tracker.add_argument
    option("episode", type=Path, nargs="?", metavar="EPISODE", help="a recorded episode (.npz)")
    live = "instead of an episode, read clouds from standard input, .npy arrays one after another, and print a line of JSON"
    option("--live", action="store_true", help=f"{live} for each as it comes")
    option("--out", type=Path, metavar="TRACKS", help="tracks to write (default EPISODE.tracks.npz)")
    option("--plot", type=Path, metavar="PICTURE", help="also draw the tracks (.png, .svg or .pdf)")
    clouds = "all vertices (default) or the subsample an observer sees"
    option("--cloud", choices=("points", "observed"), default="points", help=clouds)
    for name, what in (("alpha", "sampling"), ("beta", "jitter of killers"), ("epsilon", "motion a frame")):
        option(f"--{name}", type=float, help=f"{what} in metres (default: estimated)")
    option(
        "--paper", action="store_true", help="the paper's tracker; options given beside it take the place of its own"
    )
    option("--loops", choices=("evidence", "alpha"), help="which bars are loops (default: by evidence without --alpha)")
    option("--gates", choices=("near", "proved", "paper"), help="how far a loop may move (default near)")
    identity = "what a loop's place is (default killer-triangles; the paper's killer edge can jump)"
    option("--identity", choices=("killer-edge", "killer-triangles", "cycle"), help=identity)
    option("--memory", type=int, metavar="FRAMES", help="how long a missed loop is remembered (default 20)")
    tracker.set_defaults(run=_track)


def _simulate(options: argparse.Namespace) -> int:
    from .io import save_episode

    if options.out.suffix != ".npz":
        raise ValueError(f"--out {options.out}: the name of an episode ends in .npz")
    episode = _simulated(options)
    path = save_episode(options.out, episode)
    answer: dict[str, Any] = {"episode": str(path)}
    answer |= {name: getattr(episode, name) for name in ("task", "seed", "garment", "target")}
    answer |= {"frames": len(episode), "vertices": episode.points.shape[1], "observed": episode.observed.shape[1]}
    answer |= {"success": episode.success}
    outcome = "it hangs" if episode.success else "it does not hang"
    words = "{episode}: {garment} to {target}, {frames} frames, {vertices} vertices".format(**answer)
    print(json.dumps(answer) if options.json else f"{words}; {outcome}")
    return 0


def _simulated(options: argparse.Namespace) -> Any:
    """The episode that was asked for."""
    from .sim import TASKS, DepthNoise, Randomisation, cameras_around, simulate

    if options.task not in TASKS:
        raise ValueError(f"--task {options.task}: there is no such task; there are {', '.join(TASKS)}")
    if options.cameras < 0 or (options.noise and not options.cameras):
        raise ValueError(f"--cameras {options.cameras}: a number of cameras, one at least with --noise")
    noise, seat = DepthNoise() if options.noise else None, TASKS[options.task].target.seat
    return simulate(
        task=options.task,
        seed=options.seed,
        randomisation=Randomisation() if options.randomise else None,
        cameras=cameras_around(seat, options.cameras, distance=2.2, noise=noise) if options.cameras else (),
        n_observed=options.observed,
        time_limit=options.time_limit,
        progress=sys.stderr.isatty() and not options.json,
    )


def _track(options: argparse.Namespace) -> int:
    from .evaluate import summarise_tracks
    from .io import load_episode, save_states

    how = dict(PAPER) if options.paper else {}
    how |= {name: value for name in _TRACKER if (value := getattr(options, name)) is not None}
    if options.live:
        return _track_live(options, how)
    out = _tracks_file(options)
    if options.plot:
        if options.plot.suffix not in _PICTURES:
            raise ValueError(f"--plot {options.plot}: the name of a picture ends in {', '.join(_PICTURES)}")
        from .view import track_figure  # before the work, so that a missing matplotlib is said at once
    episode = load_episode(options.episode)
    loud = sys.stderr.isatty() and not options.json
    states = track(getattr(episode, options.cloud), times=episode.times, progress=loud, **how)
    summaries = summarise_tracks(states, episode.points, episode.loops)
    save_states(out, states)
    if options.plot:
        with atomic_file(options.plot) as picture:
            track_figure(episode, states).savefig(picture, format=options.plot.suffix[1:])
    if options.json:
        rows = [dataclasses.asdict(summary) for summary in summaries]
        print(json.dumps({"episode": str(options.episode), "frames": len(states), "tracks": str(out), "loops": rows}))
        return 0
    print(f"{options.episode}: {episode.garment} to {episode.target}, {len(states)} frames, {options.cloud}")
    _print_table(summaries)
    print(f"tracks: {out}" + (f"\npicture: {options.plot}" if options.plot else ""))
    return 0


def _tracks_file(options: argparse.Namespace) -> Path:
    if options.episode is None:
        raise ValueError("which EPISODE? (or --live, to read clouds from standard input)")
    out: Path = options.out or options.episode.with_suffix(".tracks.npz")
    if out.resolve() == options.episode.resolve():
        raise ValueError(f"--out {out}: that is the episode itself")
    if out.suffix != ".npz":
        raise ValueError(f"--out {out}: the name of tracks ends in .npz")
    return out


def _print_table(summaries: Sequence[Any]) -> None:
    """The identities of an episode, a line each."""
    heads = ("id", "first", "last", "frames", "lifetime", " true loop", "distance", "in hull")
    print("{:>4} {:>6} {:>5} {:>7} {:>9} {:>10} {:>9} {:>8}".format(*heads))
    for row in summaries:
        where = "-" if row.true_loop < 0 else str(row.true_loop)
        print(
            f"{row.id:>4} {row.first:>6} {row.last:>5} {row.frames:>7} {100 * row.lifetime:>6.2f} cm  {where:>9} "
            f"{100 * row.distance:>6.2f} cm {100 * row.in_hull:>6.1f} %"
        )
    if not summaries:
        print("   no loop in any frame")


def _track_live(options: argparse.Namespace, how: dict[str, Any]) -> int:
    """Track clouds as they come; what is kept does not grow."""
    if options.episode or options.out or options.plot:
        raise ValueError("--live reads standard input and writes standard output: leave out EPISODE, --out and --plot")
    if sys.stdin is None:
        raise ValueError("standard input is closed; pipe the clouds in")
    frames = 0
    try:
        for state in SeqPH(**how).stream(_clouds(sys.stdin.buffer)):
            frames += 1
            print(json.dumps(state.as_dict()), flush=True)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped after {frames} frames, which were printed") from None
    return 0


def _clouds(stream: Any) -> Iterator[NDArray[np.float64]]:
    """The .npy arrays of a stream, until it ends."""
    for number in count():
        if not stream.peek(1):
            return
        try:
            yield _cloud(stream)
        except Exception as error:  # a header can be wrong in a dozen ways
            raise FormatError(f"frame {number} on standard input is no whole .npy array: {error}") from error


def _cloud(stream: Any) -> NDArray[Any]:
    """The next array of a stream; memory is taken when what its header declares is no more than a cloud."""
    head = np.lib.format
    read = head.read_array_header_1_0 if head.read_magic(stream) == (1, 0) else head.read_array_header_2_0
    shape, columns_first, kind = read(stream)
    size = math.prod(shape) * kind.itemsize
    if kind.hasobject or not 0 <= size <= _LARGEST_FRAME:
        raise ValueError(f"its header declares {size} bytes of {kind}; {_LARGEST_FRAME} of numbers at most")
    data = stream.read(size)
    if len(data) < size:
        raise ValueError(f"{len(data)} of {size} bytes")
    return np.ndarray(shape, kind, data, order="F" if columns_first else "C")
