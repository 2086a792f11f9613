"""The commands `topokit train` and `predict`. What they need is imported when they run."""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any


def add(commands: Any) -> None:
    """Add the sub-parsers."""
    train = commands.add_parser("train", help="train a predictor on a dataset; goes on where it stopped")
    train.add_argument("config", type=Path, metavar="CONFIG", help="what to train, how, on what (.json)")
    train.add_argument("--seed", type=int, help="instead of the configuration's; with --out, to train several")
    train.add_argument("--out", metavar="DIR", help="where checkpoints and log go, instead of the configuration's")
    train.add_argument("--quiet", action="store_true", help="no progress bar")
    train.set_defaults(run=_train)

    predict = commands.add_parser("predict", help="forecast the loops of a recorded episode from one of its frames on")
    predict.add_argument("checkpoint", type=Path, metavar="CHECKPOINT", help="a trained predictor (.safetensors)")
    predict.add_argument("episode", type=Path, metavar="EPISODE", help="a recorded episode (.npz)")
    predict.add_argument("--frame", type=int, default=15, metavar="T", help="the last frame that is seen (default 15)")
    predict.set_defaults(run=_predict)


def _train(options: argparse.Namespace) -> int:
    from . import load_config, open_windows, train

    changes = {name: value for name, value in (("seed", options.seed), ("out", options.out)) if value is not None}
    config = replace(load_config(options.config), **changes)
    try:
        show = sys.stderr.isatty() and not (options.json or options.quiet)
        answer = train(config, open_windows(config), progress=show)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; the same command goes on from {config.out}/last.safetensors") from None
    if options.json:
        print(json.dumps(answer))
    else:
        loss = f"{answer['validation_loss']:.4f} in epoch {answer['best_epoch'] + 1} of {answer['epochs']}"
        speed = f", {answer['windows_per_second']:.0f} windows/s" if answer["windows_per_second"] else ""
        model = f"{answer['checkpoint']}: {answer['model']}, {answer['parameters']:,} parameters"
        print(f"{model}, validation loss {loss}{speed}")
    return 0


def _predict(options: argparse.Namespace) -> int:
    import numpy as np

    from topokit.io import load_episode

    from . import Predictor

    predictor = Predictor.load(options.checkpoint)
    episode = load_episode(options.episode)
    t, last, shape = options.frame, len(episode) - 1, predictor.model.shape
    if not 0 <= t < last:
        raise ValueError(f"--frame {t}: the episode has frames 0 to {last}, and one must be left to forecast")
    for frame in range(max(0, t - shape.history + 1), t + 1):
        seen = episode.observed[frame], episode.grippers[frame], bool(episode.held[frame])
        predictor.observe(*seen, target=episode.centre_line)
    ahead = np.minimum(np.arange(t + 1, t + 1 + shape.horizon), last)  # past its end the last action goes on
    forecast = predictor.predict(episode.actions[ahead], episode.held[ahead])
    if options.json:
        about = {name: predictor.description.get(name) for name in ("model", "dataset", "topokit")}
        steps = [[loop.as_dict() for loop in forecast[step]] for step in range(len(forecast))]
        print(json.dumps({"episode": str(options.episode), "frame": t, **about, "steps": steps}))
        return 0
    print(f"{predictor.description.get('model')} at frame {t} of {options.episode}: loops that are forecast")
    print(f"{'frame':>6} {'slot':>5} {'present':>8} {'lifetime':>9}   mean of the mixture (m)")
    for step in sorted({0, *range(14, shape.horizon, 15), shape.horizon - 1}):
        for loop in forecast[step]:
            x, y, z = loop.mixture().mean
            lifetime = f"{100 * loop.lifetime:6.2f} cm"
            print(f"{t + 1 + step:>6} {loop.slot:>5} {loop.presence:>8.2f} {lifetime}   {x:7.3f} {y:7.3f} {z:7.3f}")
    return 0
