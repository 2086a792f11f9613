"""The tables of paper.py: shares with intervals, and the differences of the claims.

Idea: every forecaster gets the same bootstrap draws of films, so that a difference of two shares is on the same films. A model is
named here by its forecaster and its number of training films, `mlp|500`.
"""

from typing import Any

import pandas as pd
from tables import bootstrap, interval, quotient

# Each measure: the column of distances, and the largest that counts. Those of records of other protocols are of commit b5e40830.
MEASURES = {
    "opening": ("opening_distance", 1e-9),  # metres outside the hull of the marked vertices
    "killer": ("killer_distance", 1.0),  # halves of the edge that ends the loop, from its middle
}
SAME_POINTS = ("seqph_128_points", "seqph_32_points")  # seqPH on the points that PointNet and the MLP are shown
FEW = 5  # films of a garment; with fewer, its films are drawn with those of other such garments
DRAWS = 1000


def shares_of(samples: pd.DataFrame, draws_seed: int = 0) -> dict[str, tuple[pd.DataFrame, pd.Series]]:
    """Return for each measure the shares in all draws, and the numbers of windows measured.

    Columns are (model, seed or "all", horizon or "mean").
    """
    samples = samples.copy()
    films = samples.groupby("garment")["episode"].nunique()
    samples["garment"] = samples["garment"].where(samples["garment"].map(films) >= FEW, "few films")
    samples["model"] = samples["model"] + "|" + samples["films"].astype(str)
    for name, (column, beside) in MEASURES.items():
        samples[name] = (samples[column] <= beside).where(samples[column].notna()).astype(float)
        samples[f"{name}_n"] = samples[column].notna().astype(float)
    columns = [*MEASURES, *(f"{name}_n" for name in MEASURES)]

    # All seeds together, and each of them alone where a model has several.
    seeds = samples.groupby("model")["seed"].transform("nunique")
    parts = {"all": samples} | {str(seed): part for seed, part in samples[seeds > 1].groupby("seed")}
    totals = {seed: bootstrap(part, columns, DRAWS, draws_seed) for seed, part in parts.items()}
    answer = {}
    for name in MEASURES:
        shares = {}
        counts = {}
        for seed, sums in totals.items():
            share, measured = quotient(sums, name, f"{name}_n")
            for model in share.columns.unique(0):
                for step in share[model]:
                    shares[model, seed, str(step)] = share[model][step]
                    counts[model, seed, str(step)] = measured[model][step].iloc[0]
                shares[model, seed, "mean"] = share[model].mean(axis=1)
                counts[model, seed, "mean"] = measured[model].iloc[0].max()
        answer[name] = pd.DataFrame(shares), pd.Series(counts)
    return answer


def table_of(samples: pd.DataFrame, films: int) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Return the tidy table, and the differences of the claims.

    Claims are about the networks trained on `films` films.
    """
    rows = []
    claims = {}
    for measure, (shares, counts) in shares_of(samples).items():
        claims[measure] = differences(shares, films)
        cells = interval(shares)
        for (model, seed, horizon), cell in cells.rename(columns={"mean": "share"}).iterrows():
            forecaster, _, training_films = model.partition("|")
            row = {"measure": measure, "forecaster": forecaster, "training_films": int(training_films), "seed": seed}
            row |= {"horizon": horizon, **cell, "films": samples["episode"].nunique()}
            rows.append(row | {"windows": int(counts[model, seed, horizon])})
    return pd.DataFrame(rows), claims


def differences(shares: pd.DataFrame, films: int) -> dict[str, Any]:
    """Return the differences that the claims are about, in points: mean, low and high, by horizon.

    Networks are those trained on `films` films; a Motion has one number of films.
    """
    models = {}
    for model in shares.columns.unique(0):
        name, _, trained_on = model.partition("|")
        if int(trained_on) in (0, films) or name.startswith("motion"):
            models[name] = model
    rivals = [name for name in models if name.startswith(("mlp", "pointnet", "graph"))]
    pairs = [(rival, other) for rival in rivals for other in ("seqph", *SAME_POINTS, "hold", "carry", "blind")]
    pairs += [("pointnet", "mlp"), *(("motion", other) for other in models if other != "motion")]
    found = {}
    for one, other in pairs:
        if one in models and other in models:
            found[f"{one} - {other}"] = _in_points(shares[models[one]]["all"] - shares[models[other]]["all"])
    return found


def _in_points(differences: pd.DataFrame) -> dict[str, Any]:
    """Return the mean, low and high of drawn differences of shares, in points, by horizon."""
    points = 100 * differences
    cells = interval(points).round(2)
    return {step: cells.loc[step].tolist() for step in cells.index}
