"""The copies of the chapters for JupyterLab: nothing is left that only the book understands, and no work of a reader is lost."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import pytest

pytest.importorskip("pybtex")

ROOT = Path(__file__).parents[1]
with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(ROOT / "book")
    lab = importlib.import_module("lab")

SHOWN = '<abbr title="A complex of &quot;near&quot; points.">complex</abbr>'
NAMES = lab.Names({"rips complex": 'A complex of "near" points.'}, {"a2021": ("Antonova et al.", "2021")})
NAMES.add("01_b.ipynb", ":::{prf:theorem} Lune theorem\n:label: thm-lune\n\nText.\n:::\n$$ x $$ (gates)")


@pytest.mark.parametrize(
    ("source", "shown"),
    [
        ("a {term}`complex <Rips complex>`", f"a {SHOWN}"),
        ("by {prf:ref}`thm-lune` and {eq}`gates`", "by [theorem *Lune theorem*](01_b.ipynb) and [(gates)](01_b.ipynb)"),
        ("by {prf:ref}`it <thm-lune>`", "by [it](01_b.ipynb)"),
        ("so {cite:p}`a2021`; {cite:t}`a2021`", "so (Antonova et al. 2021); Antonova et al. (2021)"),
        ("$$ x = y $$ (sum)", "$$ x = y \\tag{sum} $$"),
        (":::{prf:proof}\nTwo\n\nlines.\n:::", "> **Proof.** Two\n>\n> lines."),
        ("::::{exercise} A sock\n:label: ex-a\n\n**Warm-up.** Why?\n::::", "### Exercise: A sock\n\n**Warm-up.** Why?\n"),
        (f"Text\n\n{lab.OUTSIDE}", "Text\n\n"),
        ("`{term}` is `code`, {term}`complex <rips complex>`", f"`{{term}}` is `code`, {SHOWN}"),
    ],
)  # fmt: skip
def test_a_piece_in_plain_markdown(source, shown):
    assert lab.plain(source, NAMES) == shown


def test_copies_of_all_chapters(tmp_path, capsys):
    lab.main(tmp_path)
    copies = sorted((tmp_path / "notebooks").glob("*.ipynb"))
    assert len(copies) == len(list((ROOT / "notebooks").glob("*.ipynb")))
    for copy in copies:
        cells = json.loads(copy.read_text())["cells"]
        original = json.loads((ROOT / "notebooks" / copy.name).read_text())["cells"]
        assert lab.NOTE in "".join(cells[0]["source"])
        assert "".join(original[0]["source"]).endswith(f"\n\n{lab.OUTSIDE}")
        for cell, before in zip(cells, original, strict=True):
            if cell["cell_type"] == "code":
                assert cell == before
                continue
            prose = re.sub(r"^```.*?^```$|`[^`\n]+`", "", "".join(cell["source"]), flags=re.MULTILINE | re.DOTALL)
            assert not re.search(r"^:{2,}|^:[a-z]+:|\{[a-z]+:?[a-z]*\}`|\$\$ *\([a-z]|^%", prose, re.MULTILINE), (
                copy.name
            )
    # What the notebooks read lies beside their copies.
    assert (tmp_path / "notebooks" / "../data_small/apron_hook_0.npz").is_file()
    assert (tmp_path / "notebooks" / "chapter_tools" / "__init__.py").is_file()

    # A copy in which a reader has worked is kept; all others are written anew.
    copies[0].write_text("mine")
    copies[1].unlink()
    lab.main(tmp_path)
    assert copies[0].read_text() == "mine"
    assert copies[1].is_file()
    assert capsys.readouterr().out.count("kept") == 1
