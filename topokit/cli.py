"""The `topokit` command. Exit code 0 when all is well, 1 when the work failed, 2 when the input or the call is wrong."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from . import __version__
from .seqph import track

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (those of the process when None) and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options)
        return code
    except (ValueError, TypeError, OSError, ImportError) as error:
        print(f"topokit {options.command}: error: {error}", file=sys.stderr)
        return 2
    except RuntimeError as error:  # the input was right, the work failed: a simulation that exploded
        print(f"topokit {options.command}: failed: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"topokit {options.command}: stopped; nothing was written", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="topokit", description="Sequential topology for deformable objects.")
    parser.add_argument("--version", action="version", version=f"topokit {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    simulate = commands.add_parser("simulate", help="record an episode: an apron carried to a hook")
    simulate.add_argument("--seed", type=int, default=0, help="of the grippers' path (default 0)")
    simulate.add_argument("--out", type=Path, required=True, metavar="EPISODE", help="where to write it (.npz)")
    simulate.add_argument("--json", action="store_true", help="print the answer as JSON")
    simulate.set_defaults(run=_simulate)

    tracker = commands.add_parser("track", help="follow the loops of a recorded episode")
    tracker.add_argument("episode", type=Path, metavar="EPISODE", help="an episode that topokit recorded (.npz)")
    tracker.add_argument("--out", type=Path, metavar="TRACKS", help="tracks to write (default EPISODE.tracks.npz)")
    tracker.add_argument("--plot", type=Path, metavar="PICTURE", help="also draw the tracks (.png, .svg or .pdf)")
    tracker.add_argument(
        "--cloud",
        choices=("points", "observed"),
        default="points",
        help="all vertices (default) or the subsample an observer sees",
    )
    for name, what in (("alpha", "sampling"), ("beta", "jitter of killers"), ("epsilon", "motion a frame")):
        tracker.add_argument(f"--{name}", type=float, help=f"{what} in metres (default: estimated)")
    tracker.add_argument("--gates", choices=("paper", "proved"), default="paper", help="how far a loop may move")
    tracker.add_argument("--tolerance", type=float, default=0.0, help="metres beside the hull that count as in it")
    tracker.add_argument("--json", action="store_true", help="print the answer as JSON")
    tracker.set_defaults(run=_track)
    return parser


def _simulate(options: argparse.Namespace) -> int:
    from .io import save_episode
    from .sim import simulate

    if options.out.suffix != ".npz":
        raise ValueError(f"--out {options.out}: the name of an episode ends in .npz")
    episode = simulate(seed=options.seed, progress=sys.stderr.isatty() and not options.json)
    path = save_episode(options.out, episode)
    answer = {
        "episode": str(path),
        "garment": episode.garment,
        "target": episode.target,
        "frames": len(episode),
        "vertices": episode.points.shape[1],
        "observed": episode.observed.shape[1],
        "success": episode.success,
    }
    if options.json:
        print(json.dumps(answer))
    else:
        outcome = "it hangs" if episode.success else "it does not hang"
        print(
            f"{path}: {episode.garment} to {episode.target}, {len(episode)} frames, {answer['vertices']} vertices; {outcome}"
        )
    return 0


def _track(options: argparse.Namespace) -> int:
    from .evaluate import summarise_tracks
    from .io import load_episode, save_states

    out = options.out or options.episode.with_suffix(".tracks.npz")
    if out.resolve() == options.episode.resolve():
        raise ValueError(f"--out {out}: that is the episode itself")
    if out.suffix != ".npz":
        raise ValueError(f"--out {out}: the name of tracks ends in .npz")
    if options.plot:
        from .view import track_figure  # before the work, so that a missing matplotlib is said at once
    episode = load_episode(options.episode)
    states = track(
        getattr(episode, options.cloud),
        times=episode.times,
        alpha=options.alpha,
        beta=options.beta,
        epsilon=options.epsilon,
        gates=options.gates,
    )
    summaries = summarise_tracks(states, episode.points, episode.loops, tolerance=options.tolerance)
    save_states(out, states)
    if options.plot:
        options.plot.parent.mkdir(parents=True, exist_ok=True)
        track_figure(episode, states).savefig(options.plot)
    if options.json:
        rows = [dataclasses.asdict(summary) for summary in summaries]
        print(json.dumps({"episode": str(options.episode), "frames": len(states), "tracks": str(out), "loops": rows}))
        return 0
    print(f"{options.episode}: {episode.garment} to {episode.target}, {len(states)} frames, {options.cloud}")
    print(
        f"{'id':>4} {'first':>6} {'last':>5} {'frames':>7} {'lifetime':>9}  {'true loop':>9} {'distance':>9} {'in hull':>8}"
    )
    for row in summaries:
        where = "-" if row.true_loop < 0 else str(row.true_loop)
        print(
            f"{row.id:>4} {row.first:>6} {row.last:>5} {row.frames:>7} {100 * row.lifetime:>6.2f} cm  {where:>9} "
            f"{100 * row.distance:>6.2f} cm {100 * row.in_hull:>6.1f} %"
        )
    if not summaries:
        print("   no loop of a lifetime above alpha in any frame")
    print(f"tracks: {out}" + (f"\npicture: {options.plot}" if options.plot else ""))
    return 0


if __name__ == "__main__":
    sys.exit(main())
