"""The figure of an evaluation's shares: that its page has every cell of the file, and that its script finds them."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_view import unpack

from topokit import view
from topokit.evaluate import read_results

from pages import NETWORK, by_script, needs_node, page_data

RESULTS = Path(__file__).parents[1] / "book" / "results"
MEASURES = {"hull": "hull_accuracy", "strict": "marked curve alone, within 0 cm", "opening": "in_opening"}
KINDS = ("condition", "garment", "measure", "model", "horizon")


@pytest.fixture(params=["motion", "unseen"])
def results(request):
    return read_results(RESULTS / f"{request.param}.json")


def cell_of(results, condition, garment, measure, model, horizon):
    """What the file says, or None."""
    part = results["conditions"][condition]
    part = part if garment == "all" else part.get("by_garment", {}).get(garment, {})
    way = MEASURES[measure]
    found = part.get("hull_treatments", {}).get(way) or part.get(way, {})
    return found.get(model, {}).get(horizon)


def all_cells(results, data):
    """Every index of the table, and the cell of the file that belongs there."""
    models = list(next(iter(results["conditions"].values()))["hull_accuracy"])
    names = [*(data[kind] for kind in KINDS[:3]), models, data["horizon"]]
    for c, condition in enumerate(names[0]):
        for g, garment in enumerate(names[1]):
            for w, measure in enumerate(names[2]):
                for m, model in enumerate(models):
                    for h, horizon in enumerate(data["horizon"]):
                        yield (c, g, w, m, h), cell_of(results, condition, garment, measure, model, horizon)


def test_page_has_every_share_of_the_file_to_the_last_digit(results):
    one_garment_each = not all("by_garment" in part for part in results["conditions"].values())
    figure = view.shares(results, MEASURES)
    assert not NETWORK.search(figure.page)
    data = page_data(figure)
    cells, counts, there = unpack(data["cells"]), unpack(data["counts"]), 0
    assert data["model"][data["marks"][0]] == results["ours"].capitalize()
    for (c, g, w, m, h), cell in all_cells(results, data):
        told = cells[c, g, w, m, h]
        if cell is None or cell["mean"] is None:
            assert told[0] == 65535
            continue
        there += 1
        assert told[0] / 1e4 == pytest.approx(cell["mean"], abs=1e-9)
        assert counts[c, g, w, h, 0] == cell["n"]
        if cell["low"] is not None:
            assert (told[1:] / 1e4).tolist() == pytest.approx([cell["low"], cell["high"]], abs=1e-9)
    assert there == 945 if one_garment_each else there > 1000


@needs_node
def test_script_finds_the_cells(results):
    data = page_data(view.shares(results, MEASURES))
    table = unpack(data["cells"]).ravel().tolist()
    asked, wanted = zip(*list(all_cells(results, data))[::37], strict=True)
    given = [{"table": table, "shape": data["cells"]["shape"], "asked": [list(index) for index in asked]}]
    call = "({ table, shape, asked }) => asked.map((index) => cellAt(table, shape, index))"
    [told] = by_script(["shares.js"], call, given)
    for cell, share in zip(wanted, told, strict=True):
        assert share[0] == (65535 if cell is None or cell["mean"] is None else round(1e4 * cell["mean"]))
