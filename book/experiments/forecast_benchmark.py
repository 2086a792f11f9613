"""Make the films of the forecast benchmark, and score anyone's forecasts of them.

    python book/experiments/forecast_benchmark.py films --films FILMS
    python book/experiments/forecast_benchmark.py answers carry --films FILMS      # writes carry.csv
    python book/experiments/forecast_benchmark.py score mine.csv --films FILMS
    python book/experiments/forecast_benchmark.py record --films FILMS

`films` makes and labels the films that are missing, and compares all of them with the recorded checksums. `answers` writes what a
baseline or a checkpoint forecasts, as an example of the format. `score` prints shares with 95 % intervals over films, beside
those of the baselines on the same windows. `record` writes checksums and the baselines' shares to
book/results/forecast_benchmark.json and into the page *A benchmark of forecasts*, which has the rules.
"""

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from _paper_tables import shares_of
from forecasts import BATCH, HORIZONS, Forecaster, measure, of_predictor, of_windows, states_at
from tables import in_page, interval, write_results
from torch.utils.data import default_collate

from topokit.data import Dataset, DatasetConfig, WindowDataset, generate_dataset, label_dataset
from topokit.models import Predictor, StateTensors, build

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "book" / "results" / "forecast_benchmark.json"
PAGE = ROOT / "book" / "forecast_benchmark.md"
CONFIG = ROOT / "book" / "datasets" / "paper_test_coarse.json"
SEED = 71
EPISODES = 60
COLUMNS = ["film", "frame", "horizon", "slot", "x", "y", "z", "presence"]
ROWS = ["kind", "measure", "forecaster", "horizon"]
BASELINES = ("seqph", "hold", "carry", "ridge", "motion")  # seqPH sees the frame that the others forecast


def checksums(dataset: Dataset) -> dict[str, str]:
    """Return the SHA-256 of what is in each film, and not of its file, which names the version that wrote it."""
    found = {}
    for number, film in zip(dataset.episodes.tolist(), dataset, strict=True):
        parts = (film.points, film.observed, film.grippers, film.actions, film.held)
        found[str(number)] = hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()
    return found


def make(folder: Path) -> None:
    """Make and label the films that are missing, and say how many films are those of the record."""
    config = DatasetConfig.from_json(json.loads(CONFIG.read_text(encoding="utf-8")))
    found = checksums(generate_dataset(config, folder, EPISODES, SEED))
    label_dataset(folder)
    known = json.loads(RESULTS.read_text(encoding="utf-8"))["films"]
    same = len(found.items() & known.items())
    print(f"{len(found)} films; {same} are those of the record, which has {len(known)}")
    if same < len(known):
        print("Your machine or its libraries simulate other films: compare with the baselines that `score` prints.")


def windows_of(folder: str | Path) -> WindowDataset:
    """Return the windows that are asked about: of each film every fifth frame that has enough frames before and after it."""
    return WindowDataset(folder, stride=5)


def forecaster(name: str, windows: WindowDataset) -> Forecaster:
    """Return a baseline, or a network of data_small/checkpoints, by its name; or a network by the path of its checkpoint."""
    if name == "seqph":
        return StateTensors.from_labels
    if name in ("hold", "carry"):
        return of_windows(build(name).eval())
    shipped = ROOT / "data_small" / "checkpoints" / f"{name}.safetensors"
    return of_predictor(Predictor.load(shipped if shipped.exists() else name), windows)


def answers_of(forecast: Forecaster, windows: WindowDataset) -> pd.DataFrame:
    """Return what a forecaster says. Slots are in the order of the lifetimes that it forecasts, the longest first."""
    found = []
    for rows in np.split(np.arange(len(windows)), range(BATCH, len(windows), BATCH)):
        with torch.inference_mode():
            states = forecast(default_collate([windows[row] for row in rows]))[:, [step - 1 for step in HORIZONS]]
        order = (-states.lifetime).argsort(dim=-1, stable=True)[..., None]
        values = torch.cat([states.mean, states.presence.sigmoid()[..., None]], dim=-1)  # (B, 4, slots, 4)
        found.append(values.take_along_dim(order, dim=2).flatten(0, 2))
    table = pd.MultiIndex.from_product(
        [range(len(windows)), HORIZONS, range(windows.slots)], names=["window", *COLUMNS[2:4]]
    )
    table = table.to_frame(index=False)
    table[COLUMNS[:2]] = windows.index[table["window"]]
    table[COLUMNS[4:]] = torch.cat(found).numpy()
    return table[COLUMNS]


def read_answers(path: str | Path, windows: WindowDataset) -> pd.DataFrame:
    """Return the answers of a file; raise ValueError about the first line that is wrong, or a window without an answer."""
    given = pd.read_csv(path)
    lacking = [name for name in COLUMNS if name not in given]
    if lacking:
        raise ValueError(f"{path}: no column {', '.join(lacking)}; the first line has to be {','.join(COLUMNS)}")
    table = given[COLUMNS].apply(pd.to_numeric, errors="coerce")
    is_asked = pd.MultiIndex.from_frame(table[COLUMNS[:2]]).isin(pd.MultiIndex.from_arrays(windows.index.T))
    finite = np.isfinite(table).all(axis=1)
    wrong = {
        "a value is missing or not finite; where no loop is forecast, write any place with presence 0": ~finite,
        "there is no such film; `answers hold` writes all of them": ~table["film"].isin(windows.episodes),
        "this frame is not asked about; `answers hold` writes all of them": ~is_asked,
        f"horizon has to be one of {HORIZONS}": ~table["horizon"].isin(HORIZONS),
        f"slot has to be one of 0 to {windows.slots - 1}": ~table["slot"].isin(range(windows.slots)),
        "presence has to be from 0 to 1": ~table["presence"].between(0, 1),
        "an earlier line has this film, frame, horizon and slot; remove one": table.duplicated(COLUMNS[:4]),
    }
    for what, lines in wrong.items():
        if lines.any():
            line = int(np.argmax(lines))
            raise ValueError(f"{path}, line {line + 2}, {given.loc[line, COLUMNS].to_dict()}: {what}")
    answered = set(table[COLUMNS[:3]].itertuples(index=False, name=None))
    every = [(*window, step) for window in windows.index.tolist() for step in HORIZONS]
    missing = [one for one in every if one not in answered]
    if missing:
        first = "film {}, frame {}, horizon {}".format(*missing[0])
        raise ValueError(
            f"{path}: no line for {first} ({len(missing)} are missing); add one, with presence 0 for no loop"
        )
    return table


def forecaster_of(table: pd.DataFrame, windows: WindowDataset) -> Forecaster:
    """Return the forecaster that gives these answers; a lower slot counts as a longer lifetime."""
    row_of = {pair: row for row, pair in enumerate(map(tuple, windows.index.tolist()))}
    rows = [row_of[pair] for pair in zip(table["film"], table["frame"], strict=True)]
    known = torch.zeros(len(windows), 1 + windows.horizon, windows.slots, 4)
    values = torch.tensor(table[COLUMNS[4:]].to_numpy().tolist())
    known[rows, table["horizon"].to_list(), table["slot"].to_list()] = values

    def forecast(window: Mapping[str, torch.Tensor]) -> StateTensors:
        pairs = zip(window["episode"].tolist(), window["frame"].tolist(), strict=True)
        values = known[[row_of[pair] for pair in pairs], 1:]
        lifetime = torch.arange(windows.slots, 0, -1) / 100
        return states_at(values[..., :3], values[..., 3].logit(eps=1e-6), lifetime.expand(values.shape[:3]))

    return forecast


def shares(forecasters: Mapping[str, Forecaster], windows: WindowDataset, asked: str = "") -> pd.DataFrame:
    """Return shares in per cent with intervals; rows `one - other` have what `asked` is above each of the others, in points."""
    samples = measure({name: [one] for name, one in forecasters.items()}, windows, windows, HORIZONS, 0, "windows")
    kinds = {}
    for number in windows.episodes.tolist():
        film = windows.dataset[number]
        garment = film.garment if film.garment.startswith("apron") else "other garments"
        kinds[number] = garment + (", one loop" if len(film.loops) == 1 else ", two loops or more")
    others = [name for name in forecasters if asked and name != asked]
    found = {}
    for kind, part in samples.assign(films="").groupby(samples["episode"].map(kinds)):
        for name, (drawn, _) in shares_of(part).items():
            drawn = 100 * drawn.xs("all", axis=1, level=1).drop(columns="mean", level=1)
            points = {one: drawn[f"{one}|"] for one in forecasters}
            points |= {f"{asked} - {other}": points[asked] - points[other] for other in others}
            found[f"{kind} ({part['episode'].nunique()} films)", name] = interval(pd.concat(points, axis=1))
    return pd.concat(found, names=ROWS).astype(float).round(2).reset_index()


def tables(results: Mapping[str, Any]) -> str:
    """Return a table for each kind of film and measure: a row for each forecaster and a column for each horizon."""
    rows = pd.DataFrame(results["shares"])
    whole = rows[["mean", "low", "high"]].round() + 0.0  # no -0
    cells = whole.apply(lambda row: "{:.0f} [{:.0f}, {:.0f}]".format(*row), axis=1)
    text = []
    for (kind, name), part in rows.assign(cell=cells).groupby(["kind", "measure"], sort=False):
        text += ["", f"{kind}, by `{name}`:", "", "| forecaster | t+1 | t+15 | t+30 | t+60 |", "|---|---|---|---|---|"]
        for one, of in part.groupby("forecaster", sort=False)["cell"]:
            text.append(f"| {one:14} | {' | '.join(f'{cell:16}' for cell in of)} |")
    return "\n".join(text[1:])


def main(arguments: Sequence[str] | None = None) -> None:
    """Make films, write answers, score them, or record the baselines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("films", "answers", "score", "record"))
    parser.add_argument("what", nargs="?", default="", help="a baseline or a checkpoint (answers), a file (score)")
    parser.add_argument("--films", type=Path, required=True, help="folder of the films")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    if options.command == "films":
        make(options.films)
        return
    windows = windows_of(options.films)
    if options.command == "answers":
        answers_of(forecaster(options.what, windows), windows).to_csv(f"{Path(options.what).stem}.csv", index=False)
        return
    asked = {}
    if options.command == "score":
        try:
            asked["mine"] = forecaster_of(read_answers(options.what, windows), windows)
        except (OSError, ValueError) as error:
            parser.error(str(error))
    found = shares(asked | {name: forecaster(name, windows) for name in BASELINES}, windows, *asked)
    results = {"films": checksums(windows.dataset), "shares": found.to_dict("records")}
    print(tables(results))
    if options.command == "record":
        write_results(RESULTS, results)
        PAGE.write_text(in_page(PAGE.read_text(), "forecast_benchmark.py", tables(results)))


if __name__ == "__main__":
    main()
