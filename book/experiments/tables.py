"""Tables of the records: sums with bootstrap intervals, in pandas, and a readable JSON file.

Idea: windows of one film are near copies of each other, so a hundred of them are not a hundred facts. The bootstrap draws whole
films with replacement, among those of the same garment, and training seeds likewise. The middle 95 % of what a statistic is
over a thousand such draws is its interval. All models get the same draws of films, so a difference between two of them is on
the same films.

Source: Efron and Tibshirani 1993; for samples in clusters, Davison and Hinkley 1997, section 3.8. Taught in chapter 15.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd


def draw_episodes(garments: pd.Series, draws: int = 1000, seed: int = 0) -> pd.DataFrame:
    """Return how often each draw takes each episode, (1 + draws, episodes), given its garment; row 0 takes each of them once.

    How many episodes there are of each garment was decided and not drawn, so it is the same in all draws.
    """
    rng = np.random.default_rng(seed)
    counts = np.ones((1 + draws, len(garments)))
    for places in garments.reset_index(drop=True).groupby(garments.to_numpy()).indices.values():
        counts[1:, places] = rng.multinomial(len(places), np.full(len(places), 1 / len(places)), size=draws)
    return pd.DataFrame(counts, columns=garments.index)


def draw_seeds(seeds: Sequence[int], draws: int = 1000, seed: int = 0) -> pd.DataFrame:
    """Return how often each draw takes each training seed, (1 + draws, seeds); row 0 takes each of them once."""
    return draw_episodes(pd.Series("seed", index=seeds), draws, seed)


def bootstrap(samples: pd.DataFrame, columns: list[str], draws: int = 1000, seed: int = 0) -> pd.DataFrame:
    """Return sums of some columns over bootstrap samples: a row for each draw, columns (model, step, column).

    Sums are of one training seed on average. Row 0 has the sums over the samples themselves. A mean is the quotient of two such
    sums, and `interval` makes its interval. A sample is a row with `model`, `seed`, `step`, `episode` and `garment`; nan
    counts as 0.
    """
    episodes = draw_episodes(samples.groupby("episode")["garment"].first(), draws, seed)
    totals = {}
    for number, (model, rows) in enumerate(samples.groupby("model", sort=False)):
        sums = rows.groupby(["seed", "step", "episode"])[columns].sum().stack().unstack("episode", fill_value=0.0)
        seeds = draw_seeds(rows["seed"].unique(), draws, seed=1000 * seed + number + 1)
        drawn = [episodes @ sums.loc[one].T.reindex(episodes.columns, fill_value=0.0) for one in seeds]
        totals[model] = sum(part.mul(seeds[one], axis=0) for one, part in zip(seeds, drawn, strict=True)) / len(drawn)
    return pd.concat(totals, axis=1)


def quotient(totals: pd.DataFrame, top: str, bottom: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return one column over another in all draws, and the other: (draws, model and step) each."""
    below = totals.xs(bottom, axis=1, level=2)
    return totals.xs(top, axis=1, level=2) / below.where(below > 0), below


def interval(values: pd.DataFrame) -> pd.DataFrame:
    """Return the `mean` (row 0) of each column, and the `low` and `high` end of the middle 95 % of the other rows."""
    ends = values.iloc[1:].replace([np.inf, -np.inf], np.nan).quantile([0.025, 0.975])
    return pd.DataFrame({"mean": values.iloc[0], "low": ends.iloc[0], "high": ends.iloc[1]})


def write_results(path: str | Path, results: Mapping[str, Any]) -> None:
    """Write results as JSON with a line for every innermost object or list; the file is replaced in one piece."""
    text = json.dumps(results, indent=1, allow_nan=False)
    for innermost in (r"\{[^][{}]*\}", r"\[[^][{}]*\]"):
        text = re.sub(innermost, lambda match: re.sub(r"\s+", " ", match[0]), text)
    path = Path(path)
    aside = path.with_name(f".{path.name}.part")
    aside.write_text(f"{text}\n", encoding="utf-8")
    aside.replace(path)


def in_page(page: str, script: str, tables: str) -> str:
    """Return a page whose tables, between the two marks of a script of this folder, are made anew."""
    mark = f"<!-- python book/experiments/{script} --page -->"
    end = "<!-- until here -->"
    before, rest = page.split(mark)
    _, after = rest.split(end, maxsplit=1)
    return f"{before}{mark}\n{tables}\n{end}{after}"
