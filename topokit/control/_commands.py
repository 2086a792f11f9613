"""The command `topokit hang`. What it needs is imported when it runs."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from topokit._simulate import TASKS_HELP, add_of_mesh, garment_and_task


def add(commands: Any) -> None:
    """Add the sub-parser."""
    words = "hang a garment by what is seen of it, in a closed loop; exit code 1 when it does not hang"
    form = argparse.RawDescriptionHelpFormatter
    hang = commands.add_parser("hang", help=words, formatter_class=form, epilog=TASKS_HELP)
    option = hang.add_argument
    option("--task", "--target", help="what goes where (default tote-hook; hook with --mesh), see below")
    option("--seed", type=int, default=0, help="of where it starts (default 0)")
    option("--out", type=Path, metavar="EPISODE", help="also write what happened, as an episode (.npz)")
    option("--film", type=Path, metavar="FILM", help="also write a film of it (.gif, .html)")
    option("--mesh", type=Path, metavar="FILE", help="a garment of one's own (.obj, .ply, .stl)")
    add_of_mesh(hang)
    hang.set_defaults(run=_hang)


def _hang(options: argparse.Namespace) -> int:
    from topokit import track
    from topokit.io import save_episode

    from . import hang

    for name, known in (("out", (".npz",)), ("film", (".gif", ".html"))):
        path = getattr(options, name)
        if path and path.suffix not in known:
            raise ValueError(f"--{name} {path}: the name ends in {' or '.join(known)}")
    if options.film:
        from topokit.view import player, save_animation  # before the work, so that a missing matplotlib is said at once
    garment, task = garment_and_task(options, "tote-hook")
    result = hang(task, seed=options.seed, garment=garment, progress=sys.stderr.isatty() and not options.json)
    if options.out:
        save_episode(options.out, result.episode)
    if options.film and options.film.suffix == ".gif":
        save_animation(options.film, result.episode)
    elif options.film:
        player(result.episode, track(result.episode.observed, times=result.episode.times)).save(options.film)
    answer = {"task": result.episode.task, "seed": options.seed}
    answer |= {name: getattr(result, name) for name in ("success", "linked", "reason", "steps", "seconds_a_decision")}
    words = "{task}: {reason}; {steps} frames, {0:.0f} ms a decision".format(1000 * result.seconds_a_decision, **answer)
    print(json.dumps(answer) if options.json else words)
    return 0 if result.success else 1
